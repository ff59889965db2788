"""What the error that a model leaves depends on."""

from estimation.fit.standing import Standing

_SHARE = 0.4  # of the most telling signal's share; signals with less are not named
_LEAST = 0.01


def depends_on(standing: Standing) -> list[str]:
    """Signals that the remaining error depends on in held-out runs, the most telling first."""
    shares = standing.flexible.by_signal
    most = max(shares.values(), default=0.0)
    if most < _LEAST:
        return []
    told = [name for name, share in shares.items() if share >= max(_SHARE * most, _LEAST)]
    return sorted(told, key=lambda name: -shares[name])
