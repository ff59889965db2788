"""Elements whose texts may come from files: each text is one property, never a part of code or markup."""

from typing import TypeVar

from nicegui.element import Element
from nicegui.elements.mixins.text_element import TextElement

AnyElement = TypeVar("AnyElement", bound=Element)


def set_props(element: AnyElement, **values: str | bool) -> AnyElement:
    """Set properties by key (aria_label sets aria-label); returns the element.

    `Element.props("key=value")` reads its text as code: a quote in a value would begin properties of its own.
    """
    element.props.update({key.replace("_", "-"): value for key, value in values.items()})
    return element


def heading(text: str, title: str = "") -> None:
    """A heading; `title` is shown on hover."""
    made = TextElement(tag="h2", text=text)
    if title:
        set_props(made, title=title)
