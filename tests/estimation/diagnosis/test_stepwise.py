"""Stepwise search in constructed worlds, where the residual of each effect set is known."""

from types import SimpleNamespace

import pytest

from palpate.estimation.diagnosis import search as module
from palpate.estimation.diagnosis.search import MOST_EFFECTS, backward_step, select_effects


class Letters(frozenset):
    """Effects of a model, each of its own kind."""

    def effect(self, name):
        return SimpleNamespace(kind=name)


class FittedModel(SimpleNamespace):
    __hash__ = object.__hash__


class SearchedModels:
    """Models are sets of letters; `left` says what each leaves, 100 or more where it does not."""

    coarse = None

    def __init__(self, left, *, unsound=(), exchanges=(), smooth=0.0, floor=0.0, glances="", rmse=None):
        self._left = {frozenset(names): value for names, value in left.items()}
        self._unsound = {frozenset(names) for names in unsound}
        self._exchanges = [(frozenset(one), frozenset(two)) for one, two in exchanges]
        self._smooth, self._floor, self._glances = smooth, floor, glances
        self._known, self.fits, self.selected = {}, [], {}

    def at(self, names):
        names = Letters(names)
        if names not in self._known:
            self.fits.append("".join(sorted(names)))
            left = self._left.get(names, 100.0)
            more = {"floor": lambda: self._floor, "explainable_share": lambda: self._smooth}
            solution = SimpleNamespace(held_out=left, model=names, parameters={})
            self._known[names] = FittedModel(names=names, solution=solution, rmse=left, **more)
        return self._known[names]

    def __getattr__(self, name):
        raise AssertionError(f"nobody asked for {name}")

    @property
    def start(self):
        return self.at("")

    def added_effects(self, one):
        return sorted(one.names)

    def fitted(self, model, parameters):
        return self.at(model)

    def refined(self, one):
        return one

    def refit_effect(self, one, name):
        return one

    def without(self, one, name):
        return self.at(one.names - {name})

    def extensions(self, one):
        more = [names for names in self._left if len(names - one.names) == 1 and one.names < names]
        more = [names for names in more if all(name.islower() for name in names)]
        return self.ordered([self.at(names) for names in more])[:4]

    def ordered(self, made):
        return sorted(made, key=lambda one: one.solution.held_out)

    def is_needed(self, before, after):
        return after.rmse < 0.95 * before.rmse

    def is_better(self, one, other):
        return one.rmse < 0.98 * other.rmse

    def is_sound(self, one, name):
        return one.names not in self._unsound

    def is_sensible(self, one):
        return one.names not in self._unsound

    def substitutions(self, one, name):
        return [self.at(two) for given, two in self._exchanges if given == one.names]

    def screen(self, one):
        singles = [next(iter(names)) for names in self._left if len(names) == 1]
        return [SimpleNamespace(names=one.names | {n}, possible=n.islower()) for n in singles]

    def with_candidate(self, candidate):
        return self.at(candidate.names)

    def quick_screen(self, one):
        pairs = [names for names in self._left if len(names) == 2 and one.names < names]
        found = [SimpleNamespace(names=names, held_out=self._left[names]) for names in pairs]
        return sorted(found, key=lambda pair: pair.held_out)


def sought(world, is_complete, part=lambda one: one, forms=""):
    return select_effects(world, is_complete, part, lambda: (world.coarse or world).at(forms))


def came_to(found):
    return "".join(sorted(found.names))


@pytest.mark.parametrize(
    ("left", "found"),
    [
        ({"": 100, "a": 50, "b": 60, "ab": 20, "abc": 19.5}, "ab"),  # one by one, as long as one is needed
        ({"": 100, "a": 96, "b": 97}, ""),
        ({"": 100, "a": 98, "b": 99, "c": 90}, "c"),  # the best is not needed, the next is
        ({"": 100, "a": 50, "b": 20, "ab": 10, "c": 60}, "ab"),
        ({"": 100, "a": 50, "ab": 25, "b": 25.5}, "b"),  # a became needless
        ({"": 100, "a": 90, "ab": 80, "abc": 70, "abcd": 60, "abcde": 50, "abcdef": 40}, "abcd"),
    ],
)
def test_needed_effects_are_added_and_needless_ones_dropped(left, found):
    assert len("abcd") == MOST_EFFECTS
    world = SearchedModels(left)
    assert came_to(module._forward_selection(world, world.start)) == found


def test_forward_selection_ends_where_an_earlier_one_did(monkeypatch):
    world = SearchedModels({"": 100, "a": 50, "b": 60, "ab": 20, "abc": 19.5})
    end = module._forward_selection(world, world.start)
    monkeypatch.setattr(world, "extensions", None)  # nothing is tried again
    for names in ("", "a", "ab"):
        assert module._forward_selection(world, world.at(names)) is end


def test_forward_selection_ends_when_backward_steps_undo_it():
    """An unsound effect is found again and again, and dropped each time."""
    world = SearchedModels({"": 100, "a": 50}, unsound=["a"])
    assert module._forward_selection(world, world.start) is world.start


@pytest.mark.parametrize(
    ("left", "world", "begun", "found"),
    [
        ({"": 100, "a": 50}, {}, "a", "a"),
        ({"": 100, "a": 97}, {}, "a", ""),  # needless
        ({"": 100, "a": 50, "c": 40}, {"exchanges": [("a", "c")]}, "a", "c"),  # another does better
        ({"": 100, "a": 50, "c": 49.5}, {"exchanges": [("a", "c")]}, "a", "a"),
        ({"": 100, "a": 50, "c": 49.5}, {"exchanges": [("a", "c")], "unsound": ["a"]}, "a", "c"),
        ({"": 100, "a": 50}, {"unsound": ["a"]}, "a", ""),  # nothing takes its place
        ({"": 100, "a": 50, "c": 40, "d": 30}, {"exchanges": [("a", "c"), ("a", "d")]}, "a", "c"),
    ],
)
def test_backward_step_drops_needless_and_exchanges_better_effects(left, world, begun, found):
    made = SearchedModels(left, **world)
    assert came_to(backward_step(made, made.at(begun))) == found


MISLED = {"": 100, "a": 50, "b": 55, "bc": 10}


@pytest.mark.parametrize(
    ("left", "complete", "forms", "found"),
    [
        (MISLED, {"a"}, "bc", "a"),  # it is complete: nothing else is tried
        (MISLED, set(), "bc", "bc"),  # the best first effect misleads, the forms of all kinds do not
        (MISLED, set(), "b", "bc"),  # from the forms on, what is needed is added
        (MISLED, set(), "", "a"),  # no kind has a form
        ({**MISLED, "abc": 9.9}, set(), "abc", "bc"),  # what is needless in the forms is dropped
        ({"": 100, "a": 50, "b": 60}, set(), "b", "a"),  # the forms leave more
        ({"": 100}, set(), "", ""),
        # The best pair is tried if single effects leave more than half.
        ({"": 100, "a": 101, "b": 99, "ab": 20}, set(), "", "ab"),  # neither effect helps without the other
        ({"": 100, "a": 60, "b": 99, "c": 98, "bc": 20}, set(), "", "bc"),
        ({"": 100, "a": 49, "b": 99, "c": 98, "bc": 20}, set(), "", "a"),
        ({"": 100, "a": 101, "b": 99, "ab": 97}, set(), "", ""),
    ],
)
def test_forms_and_pairs_are_tried_where_single_effects_leave_error(left, complete, forms, found):
    assert came_to(sought(SearchedModels(left), lambda one: came_to(one) in complete, forms=forms)) == found


@pytest.mark.parametrize(
    ("smooth", "floor", "found"),
    [
        (0.19, 0.0, "a"),
        (0.21, 0.0, "bc"),  # too much is left for draws to be asked
        (0.21, 47.7, "a"),
        (0.21, 47.5, "bc"),
    ],
)
def test_samples_decide_only_where_little_is_left(smooth, floor, found):
    """Of the error that a smooth law explains, or within a twentieth of the floor."""
    world = SearchedModels(MISLED, smooth=smooth, floor=floor)
    assert came_to(sought(world, lambda one: came_to(one) == "a", forms="bc")) == found


@pytest.mark.parametrize(
    ("complete", "part", "found"),
    [
        ({"abc", "ab"}, "ab", "ab"),  # draws from the two show what the third took away
        ({"abc"}, "ab", "abc"),  # the two are not complete
        ({"abc", "ab"}, "abc", "abc"),  # all three are needed
    ],
)
def test_complete_model_of_more_than_two_effects_is_reduced_to_the_sufficient_one(complete, part, found):
    world = SearchedModels({"": 100, "a": 50, "ab": 20, "abc": 10})
    assert came_to(sought(world, lambda one: came_to(one) in complete, lambda one: world.at(part))) == found


def test_unsound_effects_on_all_data_are_rejected():
    world = SearchedModels(MISLED, unsound=["bc"])
    assert came_to(sought(world, lambda one: False, forms="bc")) == "a"
    whole = SearchedModels({"": 100, "a": 50, "b": 20, "ab": 19.9})
    whole.coarse = SearchedModels({"": 100, "a": 50, "ab": 20})
    assert came_to(sought(whole, lambda one: True)) == "b"
    assert "abc" not in whole.fits


def test_best_sensible_pair_of_effects_is_found():
    left = {"": 100, **dict.fromkeys("abcdef", 99)}
    pairs = {"ab": 30, "ac": 40, "ad": 50, "ae": 10.5, "bc": 10, "cd": 60, "ef": 70}
    assert came_to(module._best_pair(SearchedModels({**left, **pairs}))) == "bc"
    assert came_to(module._best_pair(SearchedModels({**left, **pairs}, unsound=["bc"]))) == "ae"
    assert module._best_pair(SearchedModels({"": 100})) is None
