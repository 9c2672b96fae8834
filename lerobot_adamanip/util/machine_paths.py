"""Pattern of absolute paths, which are valid on one machine only. Used before anything is published."""

from __future__ import annotations

_FOLDERS = (
    "home", "root", "Users", "Volumes", "private", "tmp", "var", "opt", "srv", "media", "net", "mnt",  # systems
    "data", "dataset", "datasets", "scratch", "nfs", "gpfs", "lustre", "fsx", "efs", "afs", "share", "shared",
    "storage", "cluster", "project", "projects", "work", "workspace", "workspaces", "content", "kaggle",  # rented ones
)  # fmt: skip
"""First folders of paths that differ between machines; not those of every machine, such as /usr and /dev."""
_SYSTEM = "usr|dev|proc|sys|etc|bin|lib|lib64|sbin|run|boot"

_BEFORE = r"(?<![\w.~<>{}*)\]$-])"
"""A slash after one of these continues a relative path, a variable or an address."""
MACHINE_PATH = "|".join(
    (
        rf"{_BEFORE}/(?:{'|'.join(_FOLDERS)})/",
        rf"""(?<=["'=])/(?!(?:{_SYSTEM})/)[A-Za-z][\w.+-]*/(?=[\w.+@-])""",  # a quoted value that is a path
        r"(?<![A-Za-z])[A-Za-z]:(?:\\{1,2}|/(?!/))(?=\w)",  # a drive of Windows
        r"(?<=[\"'=\s])\\{2,4}[\w.-]+\\{1,2}(?=[\w$.-])",  # a network folder of Windows
    )
)
"""Start of an absolute path."""
