"""What is left when no known effect explains it: how much, and what it depends on."""

from estimation.diagnosis.standing import Standing

LEFT = (
    0.03  # share of the held-out error that a flexible regression may still take away from a complete model
)
NEARLY = 0.005  # of the explainable energy
_SHARE = 0.4  # of the most telling signal's share; signals with less are not named
_LEAST = 0.01


def is_explained(standing: Standing) -> bool:
    """Whether no more is left than noise."""
    return standing.left <= LEFT


def is_nearly_explained(start: Standing, end: Standing) -> bool:
    """Whether what is left, though seen, is next to nothing beside what was found."""
    floor = float(end.flexible.held_out.sum())
    explainable = start.trial.held_out - floor
    return end is not start and end.trial.held_out - floor <= NEARLY * explainable


def depends_on(standing: Standing) -> list[str]:
    """Signals that the remaining error depends on in held-out runs, the most telling first."""
    shares = {
        name: max(share, standing.flexible_judged.by_signal[name])
        for name, share in standing.flexible.by_signal.items()
    }
    most = max(shares.values(), default=0.0)
    if most < _LEAST:
        return []
    told = [name for name, share in shares.items() if share >= max(_SHARE * most, _LEAST)]
    return sorted(told, key=lambda name: -shares[name])
