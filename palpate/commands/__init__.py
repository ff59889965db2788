"""One module per command; `palpate.app` finds them and takes each one's function `command`."""
