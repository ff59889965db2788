"""Files read, base models fitted, compared and diagnosed once in a process, though many commands ask for it.

Only results that depend on nothing but the arguments are kept: the content of a file and how it is read,
or the measured channel, its base model and the effects. The first command computes all of them.
"""

import pickle
from collections import OrderedDict
from collections.abc import Callable, Hashable
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest

from palpate.estimation import diagnosis
from palpate.estimation.data import channels
from palpate.estimation.study import fits, fitting, sessions, source

_MOST_KEPT = 40  # results of each function


def kept(function: Callable[..., Any], key_of: Callable[..., Hashable]) -> Callable[..., Any]:
    """`function`, which computes anew only if `key_of` its arguments is new, or None.

    The arguments are kept beside each result, so that no other object gets the identity that is in the key.
    """
    known: OrderedDict[Hashable, tuple[Any, Any]] = OrderedDict()

    def from_known(*arguments: Any, **options: Any) -> Any:
        key = key_of(*arguments, **options)
        if key is None:
            return function(*arguments, **options)
        if key not in known:
            known[key] = arguments, function(*arguments, **options)
        known.move_to_end(key)
        if len(known) > _MOST_KEPT:
            known.popitem(last=False)
        return known[key][1]

    return from_known


def _content_and_options(path, options):
    """The folder of a file does not matter, unless it describes the file, as that of a LeRobot data set."""
    is_alone = Path(path).is_file() and Path(path).suffix != ".parquet"
    return (Path(path).name, Path(path).read_bytes(), repr(options)) if is_alone else None


def _session_and_runs(path, runs):
    state = path.stat()
    return str(path), state.st_ino, state.st_size, state.st_mtime_ns, runs


def _sessions(*sessions, tared=False, joints=True):
    return tuple(map(id, sessions)), tared, joints


def _measured_and_arm(data, model, arm, held_out=()):
    return id(data), model, repr(arm), tuple(held_out)


def _extension(data, parent, effect):
    return id(data), id(parent), type(effect), pickle.dumps(vars(effect))


def _channel_and_model(data, model, full_data=None):
    return id(data), id(full_data), pickle.dumps(model)


def _diagnosed(given, models, effects, *, file, processes, **_):
    kinds = tuple(type(effect) for effect in effects)
    return tuple(map(id, given)), pickle.dumps(models), kinds, file, processes


def _copied(function):
    """The result of `function` as a copy: a study takes fits out of its diagnosis."""
    return lambda *arguments, **options: deepcopy(function(*arguments, **options))


KEPT = (
    (diagnosis, "diagnose", _copied(kept(diagnosis.diagnose, _diagnosed))),
    (source, "import_file", kept(source.import_file, _content_and_options)),
    (sessions, "read_session", kept(sessions.read_session, _session_and_runs)),
    (channels, "session_channels", kept(channels.session_channels, _sessions)),
    (fits, "channel_of", kept(fits.channel_of, _measured_and_arm)),
    (fits, "quality_warnings", kept(fits.quality_warnings, _channel_and_model)),
    (fitting, "fit_base", kept(fitting.fit_base, _channel_and_model)),
    (fits, "fit_extended", kept(fits.fit_extended, _extension)),
    (
        fits,
        "compare",
        kept(fits.compare, lambda fit, base, model, noise: (id(fit), id(base), model, id(noise))),
    ),
)


def compute_once(patch: pytest.MonkeyPatch) -> None:
    """Keep the results of these functions from now on."""
    for module, name, function in KEPT:
        patch.setattr(module, name, function)
