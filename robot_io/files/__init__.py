"""Files that users write: bounded text, safe YAML, and models that say what is wrong with them."""
