"""Build hook of the wheel: what of the clone an installed library carries along.

The packages lie at the wheel's top; Snakefiles, stage scripts, schema, profiles and networks in
`cherrypicker/project`, which `cherrypicker.files.PROJECT` names where there is no clone.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

CARRIED = (
    *("Snakefile", "pyproject.toml", "config/config.yaml", "workflow", "profiles", "scripts/lab"),
    *("envs", "resources/weights"),
)


class CarriedProject(BuildHookInterface):
    """Adds the files of the project that the workflow and the commands read."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        root = Path(self.root)
        scripts = [path.relative_to(root) for path in sorted(root.glob("scripts/*.py"))]
        build_data["force_include"] |= {
            str(root / path): f"cherrypicker/project/{path}" for path in (*CARRIED, *scripts)
        }
