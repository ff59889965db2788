"""palpate: probe compliant objects with a robot arm, and find out what the model is missing."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palpate.study import Study

__all__ = ["Study"]


def __getattr__(name: str) -> Any:  # noqa: ANN401
    """`palpate.Study`, imported when it is asked for: commands that need no study start at once."""
    if name in __all__:
        from palpate.study import Study  # noqa: PLC0415

        return Study
    raise AttributeError(f"module 'palpate' has no attribute '{name}'")
