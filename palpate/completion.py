"""Names that a shell completes."""


def effect_names() -> list[str]:
    """All effects of the library."""
    from estimation.effects import EFFECTS  # noqa: PLC0415, help should not wait for it

    return list(EFFECTS)
