"""Read files with groups of arrays: HDF5, MATLAB version 7.3, and TDMS of LabVIEW."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate.estimation.data.column_names import TIME, guess_columns, split_unit
from palpate.estimation.data.file_columns import check_size
from palpate.robot_io.errors import InputError
from palpate.robot_io.extras import LazyModule

if TYPE_CHECKING:
    import h5py
    import nptdms
else:
    h5py, nptdms = LazyModule("h5py"), LazyModule("nptdms")

_MAX_DEPTH = 16  # groups within groups
_MAX_MEMBERS = 20_000  # groups, arrays and cells of one file
_MAX_AXES = 2  # arrays with more axes, such as images, are not columns


def hdf5_content(path: Path) -> dict[str, Any]:
    """Return the groups of an HDF5 file as dicts of arrays; those of MATLAB 7.3 as scipy returns older ones.

    Only what the file itself holds is read: links, and arrays stored in other files, are left out. A table
    of records becomes a dict of its fields. The blocks of a pandas table become its columns.

    Args:
        path: path of the file.

    Raises:
        InputError: the file is too large or has too many members.
    """
    with h5py.File(path, "r", locking=False) as file:
        return _Hdf5Reader(path).members(file, 0)


class _Hdf5Reader:
    """Reads the members of one file and counts their sizes."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._bytes = self._members = 0

    def members(self, group: h5py.Group, depth: int) -> dict[str, Any]:
        """Return the members of a group by name, except those that cannot be columns."""
        content = dict[str, Any]()
        for name in group:
            is_link = not isinstance(group.get(name, getlink=True), h5py.HardLink)
            if not is_link and not name.startswith("#"):  # "#": MATLAB's own tables
                value = self._value(group[name], depth + 1)
                content |= {} if value is None else {name: value}
        for labels in [name for name in content if name.startswith("block") and name.endswith("_items")]:
            matrix = content.pop(labels.replace("items", "values"), None)
            names = [
                label.decode(errors="replace") if isinstance(label, bytes) else str(label)
                for label in np.atleast_1d(content.pop(labels)).tolist()
            ]
            content |= {} if matrix is None else dict(zip(names, np.atleast_2d(matrix.T), strict=False))
        return content

    def _value(self, item: h5py.Group | h5py.Dataset | h5py.Datatype, depth: int) -> object:
        """Return a group, an array, which may hold cells, or a text; None for anything else."""
        self._members += 1
        if depth > _MAX_DEPTH or self._members > _MAX_MEMBERS:
            limit = f"{_MAX_DEPTH} levels of groups" if depth > _MAX_DEPTH else f"{_MAX_MEMBERS} arrays"
            raise InputError(f"{self._path}: holds more than the limit of {limit}")
        if "MATLAB_object_decode" in item.attrs:
            return np.array(None)  # an object of MATLAB's own classes, whose encoding is not documented
        if isinstance(item, h5py.Group):
            return self._records(self.members(item, depth))
        if not isinstance(item, h5py.Dataset):
            return None
        kinds = [item.dtype[name] for name in item.dtype.names or ()] or [item.dtype]
        is_kept = item.dtype == h5py.ref_dtype or any(k.kind in "biufSV" and not k.hasobject for k in kinds)
        is_inside = not (item.is_virtual or item.external or "MATLAB_empty" in item.attrs)  # the file itself
        may_hold_columns = item.size and is_kept and sum(n > 1 for n in item.shape) <= _MAX_AXES
        return self._array(item, depth) if is_inside and may_hold_columns else None

    def _array(self, item: h5py.Dataset, depth: int) -> object:
        self._bytes += item.size * item.dtype.itemsize
        check_size(self._path, self._bytes)
        matlab_class = item.attrs.get("MATLAB_class", b"")
        if item.dtype == h5py.ref_dtype:
            cells = [self._value(item.file[each], depth + 1) for each in item[()].T.ravel() if each]
            return np.fromiter(cells, object) if matlab_class == b"cell" else tuple(cells)
        # A record states no size of its texts of any length, so they are not read.
        fields = [name for name in item.dtype.names or () if not item.dtype[name].hasobject]
        values = (item.fields(fields) if fields else item)[()]
        array = np.squeeze(values.T if matlab_class else values)
        if matlab_class == b"char":
            return "".join(map(chr, array.ravel(order="F").tolist()))
        return {name: array[name] for name in array.dtype.names} if array.dtype.names else array

    @staticmethod
    def _records(content: dict[str, Any]) -> dict[str, Any] | list[dict[str, Any]]:
        """Return a list of structs for a MATLAB array of structs, which is stored by field."""
        fields = list(content.values())
        if not fields or not all(isinstance(f, tuple) and len(f) == len(fields[0]) for f in fields):
            return content
        return [dict(zip(content, values, strict=True)) for values in zip(*fields, strict=True)]


def tdms_content(path: Path) -> dict[str, Any]:
    """Return the groups of a TDMS file as dicts of channels, named with their units.

    The time of a group without a clock follows from the interval of its waveforms.

    Args:
        path: path of the file.

    Raises:
        InputError: the file is too large.
    """
    content = dict[str, dict[str, Any]]()
    # An index beside the file is not read: it may belong to an earlier recording.
    with path.open("rb") as opened, nptdms.TdmsFile.open(opened) as file:
        channels = [channel for group in file.groups() for channel in group.channels()]
        numeric = [each for each in channels if each.dtype.kind in "biufM" and len(each)]
        check_size(path, sum(8 * len(channel) for channel in numeric))
        for channel in numeric:
            unit, values = str(channel.properties.get("unit_string", "")), channel[:]
            name = f"{channel.name} [{unit}]" if unit and not split_unit(channel.name)[1] else channel.name
            if values.dtype.kind == "M":
                values = (values - values[0]) / np.timedelta64(1, "s")
                name = f"{channel.name} [s]"
            content.setdefault(channel.group_name, {})[name] = values
        for channel in numeric:
            group = content[channel.group_name]
            has_clock = any(guess.key == TIME for guess in guess_columns(list(group)))
            if not has_clock and (step_s := channel.properties.get("wf_increment", 0.0)) > 0.0:
                content[channel.group_name] = {"Time [s]": step_s * np.arange(len(channel))} | group
    return dict(content)
