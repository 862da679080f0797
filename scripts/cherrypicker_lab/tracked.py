"""The project as git tracks it, copied to where it may be spoilt."""

import shutil
import subprocess
from pathlib import Path


def copy_tracked(project: Path, folder: Path) -> None:
    """Copy all tracked files of a project, as they stand, to a folder."""
    names = subprocess.check_output(["git", "ls-files", "-z"], cwd=project, text=True)
    for name in filter(None, names.split("\0")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(project / name, folder / name, follow_symlinks=False)
