"""Registry: members of packages, and hints for unknown names."""

import sys
from abc import ABC, abstractmethod

import pytest

from palpate.robot_io.errors import InputError, UnknownNameError
from palpate.robot_io.registry import Registry


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

class NamelessShape(Circle):
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


def test_registry_finds_members_of_several_packages_in_order(package):
    registry = Registry("shape", Shape, package("shapes_a", two="square", one="circle"))
    assert list(registry) == ["circle", "square"]
    assert len(registry) == 2
    assert registry["circle"]().area() == 3.0
    package("shapes_c", one="circle")
    registry = Registry("shape", Shape, package("shapes_d", one="square"), "shapes_c.one")
    assert set(registry) == {"circle", "square"}


def test_duplicate_names_are_refused(package):
    registry = Registry("shape", Shape, package("shapes_e", one="circle", two="circle"))
    with pytest.raises(InputError, match="two shapes are called 'circle'"):
        len(registry)


@pytest.mark.parametrize(
    ("members", "asked", "said"),
    [
        (("circle", "square"), "circel", "; did you mean 'circle'? Valid: circle, square"),
        (("circle",), "xyz", ". Valid: circle"),
        ((), "x", ". Valid: (none found)"),
    ],
)
def test_error_for_an_unknown_name_lists_the_valid_names(package, members, asked, said):
    registry = Registry("shape", Shape, package(f"shapes_{asked}", **{name: name for name in members}))
    assert registry.get(asked) is None
    assert asked not in registry
    with pytest.raises(UnknownNameError) as caught:
        registry[asked]
    assert str(caught.value) == f"no shape is called '{asked}'{said}"
    assert dict(registry) == {name: registry[name] for name in members}
