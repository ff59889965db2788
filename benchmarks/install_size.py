"""Disk space of an installation: MB of each distribution, as source and libraries, and as bytecode.

Makes a new environment in a temporary folder, installs palpate there with pip, and adds up the disk blocks of
all files that each distribution lists. pip and setuptools themselves are not counted.

    python benchmarks/install_size.py                 # the core
    python benchmarks/install_size.py --extras sim    # with an extra
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from harness import arguments

ROOT = Path(__file__).resolve().parents[1]
NOT_COUNTED = ("pip", "setuptools")
BLOCK_BYTES = 512  # unit of st_blocks
LISTING = """
import json
from importlib.metadata import distributions
named = ((each, each.metadata["Name"]) for each in distributions())
print(json.dumps({name: [str(each.locate_file(file)) for file in each.files] for each, name in named}))
"""


def disk_bytes(files: list[str]) -> tuple[int, int]:
    """Return the bytes on disk of all files but bytecode, and of bytecode."""
    sizes = [0, 0]
    for path in {Path(file).resolve() for file in files if Path(file).exists()}:
        sizes[path.suffix == ".pyc"] += path.stat().st_blocks * BLOCK_BYTES
    return sizes[0], sizes[1]


def main() -> None:
    """Install, and print one line for each distribution, the largest first."""
    parser = arguments(__doc__)
    parser.add_argument("--extras", default="", help="extras to install, separated by commas")
    parser.add_argument("--least-mb", type=float, default=1.0, help="smaller distributions are added up")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        python = Path(folder) / "bin" / "python"
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        what = f"{ROOT}[{chosen.extras}]" if chosen.extras else str(ROOT)
        subprocess.run([python, "-m", "pip", "install", "--quiet", "--only-binary=:all:", what], check=True)
        listed = subprocess.run(
            [python, "-c", LISTING], capture_output=True, text=True, check=True, cwd=folder
        )
        sizes = {
            name: disk_bytes(files)
            for name, files in json.loads(listed.stdout).items()
            if name not in NOT_COUNTED
        }
    rows = sorted(sizes.items(), key=lambda row: -sum(row[1]))
    large = [row for row in rows if sum(row[1]) >= chosen.least_mb * 1e6]
    small = [size for _, size in rows[len(large) :]]
    large.append((f"{len(small)} others", (sum(size[0] for size in small), sum(size[1] for size in small))))
    large.append(("all", (sum(size[0] for size in sizes.values()), sum(size[1] for size in sizes.values()))))
    print(f"{'MB on CPython ' + sys.version.split()[0]:28}{'files':>9}{'bytecode':>10}{'sum':>9}")
    for name, (files, bytecode) in large:
        print(f"{name:28}{files / 1e6:9.1f}{bytecode / 1e6:10.1f}{(files + bytecode) / 1e6:9.1f}")


if __name__ == "__main__":
    main()
