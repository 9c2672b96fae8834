"""Compares behaviour with the golden values of tests/golden: ``python scripts/golden.py [--write] [--only plain]``.

``--write`` stores the present values of each file whose version was raised, and of a file that does not exist. It
refuses to replace values of the same version: raise the version in lerobot_adamanip/contract/versions.py first. While a
version is in development and has no results, delete its file of tests/golden instead.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path += [str(ROOT / "tests" / name) for name in ("helpers", "collection", "experts")]

from golden_values import ALL, Golden  # noqa: E402  (helpers of tests)


def compare(golden: Golden, *, write: bool) -> list[str]:
    """Returns the differences, one line each. With ``write``, stores the values if the version allows it."""
    values = {}
    for name, compute in golden.compute.items():
        values[name] = json.loads(json.dumps(compute()))
        sys.stderr.write(f"{golden.name}: {name}\n")
    version, stored = golden.stored()
    differences = [text for name in sorted({*values, *stored}) if (text := golden.difference(name, values.get(name)))]
    if not write or (not differences and version == golden.version):
        return differences
    if stored and version == golden.version:
        return [*differences, f"not written: {golden.advice()}"]
    # A line for each value, so that a change shows which ones differ.
    lines = ",\n".join(f"  {json.dumps(name)}: {json.dumps(value, sort_keys=True)}" for name, value in values.items())
    golden.path.write_text(f'{{"version": {golden.version}, "values": {{\n{lines}\n}}}}\n', encoding="utf-8")
    sys.stdout.write(f"written: {golden.path.relative_to(ROOT)}\n")
    return []


def main(arguments: list[str] | None = None) -> int:
    """Compares or writes. Returns 0 if nothing differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="store the present values")
    parser.add_argument("--only", choices=[each.name for each in ALL], help="this file of tests/golden alone")
    options = parser.parse_args(arguments)
    differences = [
        f"{golden.name}: {text}"
        for golden in ALL
        if options.only in (None, golden.name)
        for text in compare(golden, write=options.write)
    ]
    sys.stdout.write("".join(f"{text}\n" for text in differences))
    return 1 if differences else 0


if __name__ == "__main__":
    sys.exit(main())
