"""What every script here says when it is asked for help."""

from argparse import ArgumentParser, RawDescriptionHelpFormatter


def arguments(description: str | None) -> ArgumentParser:
    """A parser that shows what a script says of itself, line by line as it stands there."""
    return ArgumentParser(description=description, formatter_class=RawDescriptionHelpFormatter)
