"""A registry finds what lies in a folder, and helps who asks for something else."""

import sys
from abc import ABC, abstractmethod

import pytest

from robot_io.errors import InputError, UnknownNameError
from robot_io.registry import Registry


class Shape(ABC):
    name = "shape"

    @abstractmethod
    def area(self): ...


CIRCLE = """
from {here} import Shape

class Named(Shape):
    "Abstract still: has no area."
    name = "named"

class Circle(Shape):
    name = "{name}"
    def area(self): return 3.0

class Nameless(Circle):
    "A base for others: states no name of its own."
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Writes packages of shapes that can be imported, and forgets them afterwards."""
    monkeypatch.syspath_prepend(str(tmp_path))
    known = set(sys.modules)

    def write(package_name, **modules):
        folder = tmp_path / package_name
        folder.mkdir()
        (folder / "__init__.py").write_text("")
        for module, name in modules.items():
            (folder / f"{module}.py").write_text(CIRCLE.format(here=__name__, name=name))
        return package_name

    yield write
    for name in set(sys.modules) - known:
        del sys.modules[name]


def test_it_finds_concrete_members_by_name_in_order(package):
    registry = Registry("shape", Shape, package("shapes_a", two="square", one="circle"))
    assert list(registry) == ["circle", "square"]
    assert len(registry) == 2
    assert registry["circle"]().area() == 3.0


def test_a_new_file_is_enough(package, tmp_path):
    name = package("shapes_b", one="circle")
    (tmp_path / name / "new.py").write_text(CIRCLE.format(here=__name__, name="new"))
    assert "new" in Registry("shape", Shape, name)


def test_members_of_several_packages_and_of_single_modules(package):
    package("shapes_c", one="circle")
    registry = Registry("shape", Shape, package("shapes_d", one="square"), "shapes_c.one")
    assert set(registry) == {"circle", "square"}


def test_two_of_one_name_are_refused(package):
    registry = Registry("shape", Shape, package("shapes_e", one="circle", two="circle"))
    with pytest.raises(InputError, match="two shapes are called 'circle'"):
        len(registry)


def test_a_close_name_is_hinted_at(package):
    registry = Registry("shape", Shape, package("shapes_f", one="circle", two="square"))
    with pytest.raises(UnknownNameError) as caught:
        registry["circel"]
    assert str(caught.value) == ("no shape is called 'circel'; did you mean 'circle'? Valid: circle, square")


def test_without_a_close_name_the_choices_are_listed(package):
    registry = Registry("shape", Shape, package("shapes_g", one="circle"))
    with pytest.raises(InputError) as caught:
        registry["xyz"]
    assert str(caught.value) == "no shape is called 'xyz'. Valid: circle"


def test_an_empty_one_says_so(package):
    with pytest.raises(InputError, match=r"no shape is called 'x'\. Valid: \(none found\)"):
        Registry("shape", Shape, package("shapes_h"))["x"]


def test_it_behaves_as_a_mapping(package):
    registry = Registry("shape", Shape, package("shapes_i", one="circle"))
    assert registry.get("xyz") is None
    assert "xyz" not in registry
    assert dict(registry) == {"circle": registry["circle"]}
