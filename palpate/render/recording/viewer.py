"""Starts the Rerun viewer: in a window for a person, or without one to take a picture."""

import os
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import rerun_cli  # type: ignore[import-untyped]
from rerun.experimental import ViewerClient

from palpate.common.files import whole_file
from palpate.render.recording.stream import REVISION, TIME
from robot_io.errors import PalpateError

_HOST = "127.0.0.1"  # Rerun's own default is every address of the machine
_START_LIMIT_S = 30.0
_POLL_S = 0.1
_DRIVER = "without a Vulkan driver, try: apt install mesa-vulkan-drivers"
_SETTLE_S = 2.0  # curves and meshes are loaded bit by bit
_TOAST_S = 7.0  # the viewer greets with a note over its upper right corner


def open_window(recording: Path) -> None:
    """Show a recording in a window that stays when this program ends.

    Raises:
        PalpateError: the viewer's program cannot be started.
    """
    _start("--port", "auto", str(recording.absolute()), detached=True)


def take_picture(
    recording: Path, picture: Path, time_s: float, size: tuple[int, int], *, revision: int | None = None
) -> None:
    """Save what the viewer shows at a moment as PNG; needs a Vulkan driver, but no display.

    Args:
        recording: .rrd file.
        picture: .png file, replaced if it is there; it appears whole or not at all.
        time_s: moment on the session's timeline [s].
        size: width and height in pixels.
        revision: stage to show instead, in a recording of revisions.

    Raises:
        PalpateError: the viewer could not be started or did not answer.
        InputError: the picture cannot be written.
    """
    started_s = time.monotonic()
    with TemporaryDirectory() as folder, whole_file(picture) as unfinished, _headless_viewer(size) as viewer:
        shown, taken = Path(folder, "shown.rrd"), Path(folder, "taken.png")  # it takes no name but UTF-8
        shown.symlink_to(recording.absolute())
        try:
            viewer.open(str(shown))
            _wait_for(lambda: _is_loaded(viewer), "the Rerun viewer did not load the recording")
            if revision is None:
                viewer.set_time(TIME, duration=time_s, play_state="paused")
            else:
                viewer.set_time(REVISION, sequence=revision, play_state="paused")
            time.sleep(max(_SETTLE_S, _TOAST_S - (time.monotonic() - started_s)))
            viewer.save_screenshot(str(taken))
        except (OSError, RuntimeError, ValueError) as error:
            reason = str(error).partition("\n")[0] or type(error).__name__
            raise PalpateError(f"the viewer did not give a picture: {reason} ({_DRIVER})") from error
        if not taken.is_file():
            raise PalpateError(f"the viewer did not write {picture}")
        unfinished.write_bytes(taken.read_bytes())


@contextmanager
def _headless_viewer(size: tuple[int, int]) -> Iterator[ViewerClient]:
    with socket.socket() as probe:
        probe.bind((_HOST, 0))
        port = probe.getsockname()[1]
    window = f"{size[0]}x{size[1]}"
    process = _start("--headless", "--hide-welcome-screen", "--port", str(port), "--window-size", window)
    clients: list[ViewerClient] = []
    try:
        remedy = f"the Rerun viewer did not start without a display ({_DRIVER})"
        _wait_for(lambda: _connected(process, f"rerun+http://{_HOST}:{port}/proxy", clients), remedy)
        yield clients[0]
    finally:
        process.terminate()
        try:
            process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _connected(process: "subprocess.Popen[bytes]", url: str, clients: list[ViewerClient]) -> bool:
    """Whether the viewer answers; it is then the one in `clients`."""
    if process.poll() is not None:
        raise PalpateError(f"the Rerun viewer ended at once ({_DRIVER})")
    try:
        client = ViewerClient.connect(url)
        client.get_state()
    except (OSError, RuntimeError):
        return False
    clients.append(client)
    return True


def _is_loaded(viewer: ViewerClient) -> bool:
    state = viewer.get_state()
    return bool(state.active_recording) and not state.loading


def _wait_for(is_done: Callable[[], bool], failure: str) -> None:
    give_up_s = time.monotonic() + _START_LIMIT_S
    while not is_done():
        if time.monotonic() > give_up_s:
            raise PalpateError(failure)
        time.sleep(_POLL_S)


def _start(*arguments: str, detached: bool = False) -> "subprocess.Popen[bytes]":
    program = Path(rerun_cli.__file__).parent / "rerun"
    environment = os.environ | {"RERUN_APP_ONLY": "true"}  # no questions at the start
    try:
        return subprocess.Popen(  # noqa: S603, our own program with our own arguments
            [str(program), "--bind", _HOST, *arguments],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=detached,
        )
    except OSError as error:
        raise PalpateError(f"the Rerun viewer cannot be started: {error.strerror}: {program}") from error
