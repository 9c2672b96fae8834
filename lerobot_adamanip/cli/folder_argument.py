"""The folder of a dataset as every command takes it: its first argument, DIR."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

DatasetFolder = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
DatasetFolders = Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="DIR [DIR ...]")]
