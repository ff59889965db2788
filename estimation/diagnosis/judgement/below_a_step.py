"""Whether a reader that shows a handful of values only is too coarse for what a model leaves."""

import numpy as np

from estimation.fit.standing import Standing

FEW_READINGS = "different readings"  # what a reason counts where the reader's steps are too coarse
_HANDFUL = 12  # different readings in all; with more, an effort crosses so many steps that they average out


def below_a_step(standing: Standing) -> str | None:
    """Why nothing more can be said of a channel, and the remedy; None if its reader's steps are fine enough.

    A reader that rounds is off by up to half a step, one that cuts off by up to a whole one, and always in
    the same way where the motion is the same. So what depends on the motion and is less than a step may be
    the reader or the world, as long as the effort crosses only a few steps (B. Widrow, I. Kollár,
    Quantization Noise (2008): rounding is like noise only where it meets many steps, or noise larger than
    one).

    Args:
        standing: the base model.
    """
    levels = np.unique(standing.data.effort)
    if not 1 < len(levels) <= _HANDFUL:
        return None
    step = float(np.median(np.diff(levels)))
    if standing.rmse >= step:
        return None
    unit = standing.data.kind.effort_unit
    return (
        f"only {len(levels)} {FEW_READINGS}, {step:.3g} {unit} apart, and the model is off by "
        f"{standing.rmse:.3g} {unit}, less than one such step: what is left may be the reader's rounding; "
        "use a finer sensor, or a motion that takes more effort"
    )
