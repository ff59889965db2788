"""Where what is derived from a file lies: in a folder of its own name beside a session, or here."""

from pathlib import Path

from palpate.estimation_run import Material


def derived_folder(material: Material, out: Path | None) -> Path:
    """The folder; it need not be there yet.

    Args:
        material: a session, which has a folder beside it, or a data file, whose own folder may be anybody's:
            what is derived from it goes into the current one.
        out: the folder that the user wants instead.
    """
    if out is not None:
        return out
    if material.session is not None:
        return material.session.derived_dir
    return Path(f"{material.path.name.split('.')[0]}-palpate")
