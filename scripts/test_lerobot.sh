#!/usr/bin/env bash
# Runs the tests that need no simulator against another LeRobot: a release (`0.6.1`, `release` for the newest), a
# branch, tag or commit of its repository (`main`), or a checkout (a folder). The environment and report.md go to
# outputs/lerobot. It reuses packages of .venv whose versions this LeRobot accepts, and installs the others.
#   bash scripts/test_lerobot.sh main tests/policies
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

ref=$1 out=outputs/lerobot
shift
case $ref in
    release) source="lerobot" ;;
    [0-9]*.[0-9]*) source="lerobot==$ref" ;;
    */*) source="lerobot @ file://$(realpath "$ref")" ;;
    *) source="lerobot @ git+https://github.com/huggingface/lerobot@$ref" ;;
esac
rm -rf "$out"
mkdir -p "$out"
.venv/bin/python -m venv "$out/venv"
python=$out/venv/bin/python
shared=$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
echo "import site; site.addsitedir('$shared')" >"$("$python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/shared.pth"
"$python" -m pip install --quiet --upgrade "${source/lerobot/lerobot[training,diffusion,evaluation]}"

status=0
"$python" -m pytest -n "${JOBS:-2}" --dist loadfile -m "not sim and not nightly" "${@:-tests}" | tee "$out/tests.log" || status=$?
{
    "$python" -c 'import lerobot, platform, torch; print(f"## LeRobot {lerobot.__version__}, Python {platform.python_version()}, torch {torch.__version__}")'
    printf 'Source: `%s`\n\n```\n' "$source"
    grep -E '^(FAILED|ERROR) |^=+ .*(passed|failed|error)' "$out/tests.log" || echo "no test ran"
    printf '```\n'
} >"$out/report.md"
exit "$status"
