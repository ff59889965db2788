"""Settings that all tests share."""

from hypothesis import settings

# A busy machine is no failure; the same examples everywhere, so that a red test stays red until it is mended.
settings.register_profile("palpate", deadline=None, derandomize=True)
settings.load_profile("palpate")
