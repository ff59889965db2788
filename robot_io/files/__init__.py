"""Files that users write: bounded text, safe YAML, and models with precise errors."""
