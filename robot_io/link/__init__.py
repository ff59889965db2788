"""Messages between two machines: content, frames, and the line that carries them."""
