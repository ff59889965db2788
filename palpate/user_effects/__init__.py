"""Effects from files of the user's own: loaded, checked, tried, and watched over."""

from palpate.user_effects.load import load_user_effects

__all__ = ["load_user_effects"]
