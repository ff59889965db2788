"""Paths of meshes and textures in an MJCF or URDF that is copied to another folder."""

from posixpath import isabs, join, normpath
from xml.etree.ElementTree import Element

from palpate.robot_io.errors import InputError

_DIRECTORIES = ("meshdir", "texturedir")
_NOT_IN_THEM = ("include", "model")  # MuJoCo looks for these files beside the main file


def rebase_mjcf(root: Element, place: str, folder: str) -> None:
    """Let the asset directories of an MJCF lead back to the original's folder.

    Args:
        root: element <mujoco>, which is changed.
        place: origin of the file, for error messages.
        folder: path from the folder of the copy to that of the original; "." if they are the same.

    Raises:
        InputError: the file includes others, which MuJoCo would seek beside the copy.
    """
    if folder == ".":
        return
    if (included := root.find(".//include")) is not None:
        raise InputError(
            f"{place}: MuJoCo looks for the included file {included.get('file', '')} beside the main file: "
            "write the copy there with -o"
        )
    for model in root.iter("model"):
        if name := model.get("file"):
            model.set("file", _moved(name, folder))
    assets = (each for each in root.iter() if each.tag not in _NOT_IN_THEM)
    if not any(key.startswith("file") for each in assets for key in each.attrib):
        return
    compilers = root.findall("compiler")
    now = dict.fromkeys(_DIRECTORIES, "")
    for compiler in compilers:  # a later one takes precedence
        now |= dict.fromkeys(_DIRECTORIES, compiler.get("assetdir", "")) if compiler.get("assetdir") else {}
        now |= {key: compiler.get(key, "") for key in _DIRECTORIES if compiler.get(key) is not None}
    if not compilers:
        root.insert(0, Element("compiler"))
    last = root.findall("compiler")[-1]
    for key, directory in now.items():
        last.set(key, _moved(directory, folder))


def rebase_urdf(root: Element, folder: str) -> None:
    """Let the relative paths of meshes and textures in a URDF lead back to the original's folder.

    Args:
        root: element <robot>, which is changed.
        folder: path from the folder of the copy to that of the original; "." if they are the same.
    """
    compilers = [each for each in root.findall("mujoco/compiler") if each.get("meshdir")]
    for each in compilers:  # MuJoCo's own extension of the format
        each.set("meshdir", _moved(each.get("meshdir", ""), folder))
    if any(each.get("strippath") == "false" for each in compilers):
        return  # paths of meshes start at this directory
    for each in root.iter():
        name = each.get("filename", "")
        if each.tag in {"mesh", "texture"} and name and "://" not in name:
            each.set("filename", _moved(name, folder))


def _moved(path: str, folder: str) -> str:
    return path if isabs(path) or folder == "." else normpath(join(folder, path))
