"""HDF5, MATLAB 7.3 and TDMS: groups of arrays."""

import h5py
import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter

from palpate.estimation.channel import ChannelKind
from palpate.estimation.data.grouped_files import hdf5_content
from palpate.estimation.data.import_file import import_file
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.table import read_table
from palpate.robot_io.errors import InputError
from tests.estimation.press_tables import FORCE_N, TIME_S, WAY_M, check_press

ANGLES = {"position": "rad", "torque": "Nm"}
Q = np.column_stack([np.sin(3.0 * TIME_S), np.cos(2.0 * TIME_S)])


def test_groups_of_hdf5_with_a_clock_are_runs(tmp_path):
    with h5py.File(tmp_path / "arm.h5", "w") as file:
        for number in range(3):
            trial = file.create_group(f"data/trial_{number}")
            trial.create_dataset("timestamp", data=TIME_S, compression="gzip")
            trial["q"], trial["tau"] = Q, 0.5 * Q + number
            trial.create_dataset("camera", data=np.zeros((len(TIME_S), 4, 4), np.uint8))
            trial.attrs["rate"] = 100.0
    imported = import_file(tmp_path / "arm.h5", ImportOptions(units=ANGLES | {"time": "s"}))
    assert "3 groups with the same columns, read as runs" in imported.read
    assert imported.run_labels[2] == "data.trial_2"
    first, second = imported.channels
    assert [first.name, second.name] == ["joint_1", "joint_2"]
    np.testing.assert_allclose(second.effort, np.concatenate([0.5 * Q[:, 1] + n for n in range(3)]))


def test_numbered_groups_without_a_clock_are_runs_with_their_subgroups(tmp_path):
    with h5py.File(tmp_path / "demos.hdf5", "w") as file:
        for number in range(2):
            demo = file.create_group(f"data/demo_{number}")
            demo["actions"], demo["dones"] = Q, np.zeros(len(Q), np.int8)
            demo["obs/qpos"], demo["obs/qvel"], demo["obs/effort"] = Q, Q, 0.5 * Q + number
    imported = import_file(tmp_path / "demos.hdf5", ImportOptions(units=ANGLES | {"time": "20ms"}))
    assert "2 groups with the same columns, read as runs" in imported.read
    first, _ = imported.channels
    np.testing.assert_allclose(first.effort, np.concatenate([0.5 * Q[:, 0], 0.5 * Q[:, 0] + 1]))
    assert np.diff(first.time_s[: len(Q)]) == pytest.approx(0.02)


def test_records_and_pandas_tables_are_columns(tmp_path):
    kinds = [("Time (s)", float), ("Way (mm)", np.float32), ("Force (N)", float), ("note", "S4")]
    records = np.zeros(len(TIME_S), dtype=kinds)
    for name, values in zip(records.dtype.names, (TIME_S, 1e3 * WAY_M, FORCE_N), strict=False):
        records[name] = values
    with h5py.File(tmp_path / "records.hdf5", "w") as file:
        file["press"] = records
    check_press(import_file(tmp_path / "records.hdf5"))
    with h5py.File(tmp_path / "pandas.h5", "w") as file:  # as DataFrame.to_hdf writes floats and integers
        frame = file.create_group("frame")
        frame["axis0"] = np.array([b"Force (N)", b"Time (s)", b"Way (mm)"])
        frame["axis1"] = np.arange(len(TIME_S))
        frame["block0_items"] = np.array([b"Time (s)", b"Way (mm)"])
        frame["block0_values"] = np.column_stack([TIME_S, 1e3 * WAY_M])
        frame["block1_items"] = np.array([b"Force (N)"])
        frame["block1_values"] = FORCE_N[:, None]
    check_press(import_file(tmp_path / "pandas.h5"))
    with h5py.File(tmp_path / "numbered.h5", "w") as file:
        file["frame/block0_items"] = np.arange(2)
        file["frame/block0_values"] = Q
    assert read_table(tmp_path / "numbered.h5").names == ("0", "1")


def test_texts_of_any_length_in_records_are_not_read(tmp_path):
    """Their size is unknown: many records of a small file may refer to one long text."""
    records = np.zeros(3, [("note", h5py.string_dtype()), ("Time_s", float)])
    records["note"], records["Time_s"] = "by hand", np.arange(3.0)
    with h5py.File(tmp_path / "notes.h5", "w") as file:
        file["press"] = records
        file["only texts"] = records[["note"]]
    content = hdf5_content(tmp_path / "notes.h5")
    assert content.keys() == {"press"}
    assert content["press"].keys() == {"Time_s"}


def test_reference_to_nothing_is_left_out(tmp_path):
    with h5py.File(tmp_path / "press.h5", "w") as file:
        file["Time_s"], file["Way_mm"], file["Force_N"] = TIME_S, 1e3 * WAY_M, FORCE_N
        file["links"] = np.array([file["Time_s"].ref, h5py.Reference()], dtype=h5py.ref_dtype)
    check_press(import_file(tmp_path / "press.h5"))


def matlab(file, name, values, kind="double"):
    """Store a variable as MATLAB does: with reversed axes and the name of its class."""
    file[name] = values
    file[name].attrs["MATLAB_class"] = np.bytes_(kind)
    return file[name]


def test_matlab_7_3_is_read_like_older_versions(tmp_path):
    path = tmp_path / "press.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        matlab(file, "Time_s", TIME_S[None])
        matlab(file, "Way_mm", 1e3 * WAY_M[None])
        matlab(file, "results/Force_N", FORCE_N[:, None])
        matlab(file, "rate", np.array([[100.0]]))
        matlab(file, "operator", np.frombuffer("Ada".encode("utf-16-le"), np.uint16)[:, None], "char")
        empty = matlab(file, "notes", np.array([0, 0], np.uint64))
        empty.attrs["MATLAB_empty"] = 1
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\x00\x02IM")
    check_press(import_file(path))


@pytest.mark.parametrize("kind", ["struct", "cell"])
def test_structs_of_matlab_7_3_are_runs(tmp_path, kind):
    path = tmp_path / "runs.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        references = {"t": [], "q": [], "tau": []}
        structs = []
        for number in range(3):
            fields = {"t": TIME_S, "q": Q[:, 0], "tau": Q[:, 1] + number}
            for name, values in fields.items():
                references[name].append(matlab(file, f"#refs#/{number}/{name}", values[None]).ref)
            structs.append(file[f"#refs#/{number}"].ref)
        if kind == "cell":
            matlab(file, "runs", np.array(structs, dtype=h5py.ref_dtype)[:, None], "cell")
        else:
            for name, fields in references.items():
                file[f"runs/{name}"] = np.array(fields, dtype=h5py.ref_dtype)[:, None]
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: PCWIN64".ljust(116) + bytes(8) + b"\x00\x02IM")
    imported = import_file(path, ImportOptions(units=ANGLES))
    assert "3 groups with the same columns, read as runs" in imported.read
    (channel,) = imported.channels
    np.testing.assert_allclose(channel.effort, np.concatenate([Q[:, 1] + n for n in range(3)]))


def test_cells_of_matlab_7_3_are_a_matrix(tmp_path):
    path = tmp_path / "cells.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        columns = [TIME_S, Q[:, 0], Q[:, 1]]
        cells = [matlab(file, f"#refs#/{n}", values[None]).ref for n, values in enumerate(columns)]
        matlab(file, "data", np.array(cells, dtype=h5py.ref_dtype)[:, None], "cell")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: PCWIN64".ljust(116) + bytes(8) + b"\x00\x02IM")
    table = read_table(path)
    np.testing.assert_allclose([table.numbers(f"data {n}") for n in (1, 2, 3)], columns)


def test_object_of_matlab_is_named(tmp_path):
    with h5py.File(tmp_path / "log.h5", "w") as file:
        log = matlab(file, "log", np.array([[3707764736, 2, 1, 1, 1, 1]], np.uint32), "timeseries")
        log.attrs["MATLAB_object_decode"] = 3
    with pytest.raises(InputError, match=r"only log \(an object; save its vectors as variables\)"):
        read_table(tmp_path / "log.h5")


def test_nothing_outside_of_the_file_is_read(tmp_path):
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["Force_N"] = FORCE_N
    (tmp_path / "raw.bin").write_bytes(FORCE_N.tobytes())
    layout = h5py.VirtualLayout(FORCE_N.shape, float)
    layout[:] = h5py.VirtualSource(str(tmp_path / "secret.h5"), "Force_N", FORCE_N.shape)
    with h5py.File(tmp_path / "links.h5", "w") as file:
        file["Time_s"], file["Way_mm"] = TIME_S, 1e3 * WAY_M
        file["Force_N"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "/Force_N")
        file["outside"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "/")
        file["Load_N"] = h5py.SoftLink("/outside/Force_N")
        file.create_virtual_dataset("Virtual_N", layout)
        raw = [(str(tmp_path / "raw.bin"), 0, FORCE_N.nbytes)]
        file.create_dataset("Raw_N", FORCE_N.shape, float, external=raw)
    assert sorted(read_table(tmp_path / "links.h5").names) == ["Time_s", "Way_mm"]


def test_hostile_hdf5_is_refused_in_one_line(tmp_path):
    with h5py.File(tmp_path / "large.h5", "w") as file:  # a megabyte that unpacks to 32 GB
        file.create_dataset("zeros", (2**32,), float, chunks=(2**20,), compression="gzip")
    with h5py.File(tmp_path / "ring.h5", "w") as file:
        ring = file.create_group("ring")
        ring["again"] = ring
    with h5py.File(tmp_path / "empty.h5", "w"):
        pass
    (tmp_path / "text.h5").write_text("no HDF5")
    for name, said in (
        ("large", "more than the limit of"),
        ("ring", "limit of 16 levels of groups"),
        ("empty", "holds no vectors"),
        ("text", "cannot be read"),
    ):
        with pytest.raises(InputError, match=said) as refused:
            read_table(tmp_path / f"{name}.h5")
        assert "\n" not in str(refused.value)


def test_channels_of_tdms_have_units_and_the_time_of_their_waveforms(tmp_path):
    step = {"wf_start_time": np.datetime64("2026-11-30T00:00:00"), "wf_increment": float(np.diff(TIME_S)[0])}
    with TdmsWriter(tmp_path / "press.tdms") as file:
        channels = (("Way", 1e3 * WAY_M, "mm"), ("Force", FORCE_N, "N"))
        file.write_segment(
            [
                ChannelObject("Press", name, values, {**step, "unit_string": unit})
                for name, values, unit in channels
            ]
        )
        file.write_segment([ChannelObject("Press", "remark", ["by hand"])])
    (tmp_path / "press.tdms_index").write_text("of another recording")
    check_press(import_file(tmp_path / "press.tdms"))


def test_clock_of_tdms_may_be_dates(tmp_path):
    dates = np.datetime64("2026-11-30T10:00:00") + (1e6 * TIME_S).astype("timedelta64[us]")
    with TdmsWriter(tmp_path / "press.tdms") as file:
        columns = {"Zeit": dates, "Weg [mm]": 1e3 * WAY_M, "Kraft [N]": FORCE_N}
        file.write_segment([ChannelObject("Prüfung", name, values) for name, values in columns.items()])
    (channel,) = import_file(tmp_path / "press.tdms").channels
    assert channel.kind is ChannelKind.CONTACT
    np.testing.assert_allclose(channel.time_s - channel.time_s[0], TIME_S - TIME_S[0], atol=2e-6)
    np.testing.assert_allclose(channel.effort, FORCE_N)
