"""The effects that are tried: palpate's own, and those of the user."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

from estimation.channel import ChannelData
from estimation.diagnosis.search.library import library
from estimation.effect import Effect
from estimation.effects import EFFECTS
from palpate.findings.kept_revision import KeptRevision
from palpate.findings.rehearsal import rehearse
from palpate.findings.user_effect import load_user_effect
from robot_io.errors import InputError


@dataclass(frozen=True)
class EffectLibrary:
    """What is tried.

    Attributes:
        effects: all of them.
        own: FILE.py:Class by name of the user's.
    """

    effects: tuple[Effect, ...]
    own: dict[str, str]

    def rehearse(self, channels: Sequence[ChannelData]) -> None:
        """Try the user's effects before they are relied upon.

        Raises:
            InputError: one fails.
        """
        own = [effect for effect in self.effects if effect.name in self.own]
        for effect, channel in product(own, channels):
            try:
                rehearse(effect, channel)
            except InputError as error:
                raise InputError(f"--effect {self.own[effect.name]}: {error}") from error

    def check_own(self, revision: KeptRevision) -> None:
        """A revision names the user's effects, but their code is run only when the user says so now.

        Raises:
            InputError: the user did not.
        """
        for text in revision.user_effects:
            if text not in self.own.values():
                raise InputError(f"revision {revision.number} has an effect of your own: add --effect {text}")

    def get(self, name: str) -> Effect:
        """An effect by its name.

        Raises:
            InputError: there is none.
        """
        found = next((effect for effect in self.effects if effect.name == name), None)
        if found is None:
            raise InputError(EFFECTS.unknown(name))
        return found


def library_with(texts: Sequence[str] | None) -> EffectLibrary:
    """Palpate's effects and the user's.

    Args:
        texts: each of the form FILE.py:Class.

    Raises:
        InputError: a file or class is not there, cannot be run, or states no effect, or one whose name is
            taken.
    """
    palpates = library()
    loaded: dict[str, tuple[Effect, str]] = {}
    for text in texts or ():
        effect = load_user_effect(text)
        taken = "palpate" if effect.name in EFFECTS else loaded.get(effect.name, (effect, ""))[1]
        if taken and taken != text:
            raise InputError(
                f"--effect {text}: the name '{effect.name}' is taken by an effect of {taken}; "
                "give the class another name"
            )
        loaded[effect.name] = effect, text
    own = (effect for effect, _ in loaded.values())
    return EffectLibrary((*palpates, *own), {name: text for name, (_, text) in loaded.items()})
