"""`foldcell robot new NAME`: writes the skeleton of a package that brings a robot."""

from __future__ import annotations

import argparse
from pathlib import Path

from cell.commands.options import Commands, add_command, folder, json_option
from cell.commands.output import print_json
from cell.support.files.whole_file import write_whole
from robots.errors import ConfigurationError, StorageError
from robots.urdf.skeleton import skeleton_files

__all__ = ["add_options"]


def add_options(actions: Commands) -> None:
    new = add_command(actions, "new", "write the skeleton of a package that brings a robot", _run)
    new.add_argument("name", metavar="NAME", help="name of the robot, its package and its folder")
    new.add_argument("--into", type=folder, default=Path(), metavar="DIR", help="where the folder is made (here)")
    json_option(new)


def _run(options: argparse.Namespace) -> int:
    """Raises ConfigurationError for a name that cannot be used or a folder that exists, StorageError if a file
    cannot be written."""
    files, target = skeleton_files(options.name), options.into / options.name
    if target.exists():
        raise ConfigurationError(f"{target} exists", "choose another name, or another folder with --into")
    for name, text in files.items():
        path = target / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError(f"cannot make {path.parent}: {error.strerror}", "choose another --into") from error
        write_whole(path, text.encode())
    if options.json:
        print_json({"robot": options.name, "folder": str(target), "files": sorted(files)})
        return 0
    print(f"wrote {target}: {', '.join(sorted(files))}")
    print(f"install it: pip install --no-deps -e {target}")
    print(f"then: foldcell robot check {options.name}; foldcell fold small_towel --cell {target / 'cell.yaml'}")
    return 0
