"""Whether a command has answered in JSON; apart from the console, which takes longer to import."""


class Answer:
    """There is one for each command, whatever happens after it."""

    was_printed = False
