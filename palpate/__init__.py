"""palpate: probe compliant objects with a robot arm, and find out what the model is missing."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palpate.batches.run import batch
    from palpate.study import Study

__all__ = ["Study", "batch"]


def __getattr__(name: str) -> Any:  # noqa: ANN401
    """Import `palpate.Study` and `batch` on first use, so that commands that need neither start faster."""
    if name == "Study":
        from palpate.study import Study  # noqa: PLC0415

        return Study
    if name == "batch":
        from palpate.batches.run import batch  # noqa: PLC0415

        return batch
    raise AttributeError(f"module 'palpate' has no attribute '{name}'")
