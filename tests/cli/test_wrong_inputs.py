"""Wrong inputs to every command: one error, an exit status that is not 0, no traceback; a typo gets the right word."""

from __future__ import annotations

from pathlib import Path

import pytest

from lerobot_adamanip.cli.main import COMMANDS, main

COLLECT = "collect new"
WRONG = (
    ("collct", "adamanip collect"),
    ("Doctor", "adamanip doctor"),
    ("zzz", "adamanip --help"),
    ("doctor --jsn", "--json"),
    ("doctor extra", "extra"),
    ("collect", "DIR"),
    ("collect --root new", "--root"),
    (f"{COLLECT} --category dor", "did you mean door?"),
    (f"{COLLECT} --category Door", "did you mean door?"),
    (f"{COLLECT} --catgory door", "did you mean --category?"),
    (f"{COLLECT} --expert adaptiv", "did you mean adaptive?"),
    (f"{COLLECT} --poses=fix", "randomized"),
    (f"{COLLECT} --mechanism-rules papr", "did you mean paper?"),
    (f"{COLLECT} --objects 0:99", "63 unseen objects"),
    (f"{COLLECT} --category all --objects 0:40", "--objects unseen"),
    (f"{COLLECT} --objects 4:4", "nFIRST:nEND"),
    (f"{COLLECT} --objects door_000", "for category 'safe'"),
    (f"{COLLECT} --objects safe_000,safe_000", "each once"),
    (f"{COLLECT} --action joint", "--action with --control dense"),
    (f"{COLLECT} --fps 25", "--fps with --control dense"),
    (f"{COLLECT} --state full", "--state with --control dense"),
    (f"{COLLECT} --cloud", "--cloud with --control dense"),
    (f"{COLLECT} --effort", "--effort with --control dense"),
    (f"{COLLECT} --control dense --expert-share 0.5", "--expert-share with --policy"),
    (f"{COLLECT} --part 1/2 --unscaled-poses", "--unscaled-poses without --part"),
    (f"{COLLECT} --control dense --unscaled-poses", "--unscaled-poses with --action ee_pose or --state full"),
    (f"{COLLECT} --control dense --fps 7", "try:     --fps 10\n"),  # as this command has it, not --env.fps=10
    (f"{COLLECT} --control dense --self-calibration", "try:     --cloud\n"),
    (f"{COLLECT} --image-size 33", "try:     --image-size 256\n"),
    (f"{COLLECT} --expert static --trials 2", "--trials with --expert adaptive"),
    (f"{COLLECT} --mechanism-rules row --trials 2", "--trials with --expert adaptive"),
    (f"{COLLECT} --expert static --expert-strategy to_stop", "--expert-strategy with --expert adaptive"),
    (f"{COLLECT} --insecure-cluster", "--insecure-cluster with --cluster"),
    ("benchmark --scale smoke --insecure-cluster", "--insecure-cluster with --cluster"),
    ("objects --columns 3", "--columns with --out"),
    ("expert --trials 0", "--trials 1"),
    ("expert --seed 99999999999", "--seed 1000"),
    (f"{COLLECT} --mechanism-rules changing --expert-strategy upstream", "leave out --expert-strategy"),
    ("expert --mechanism-rules changing --trials 2 --episodes 0", "leave out --trials"),
    (f"{COLLECT} --episodes-per-object 0", "--episodes-per-object 1"),
    (f"{COLLECT} --episodes-per-object x", "x"),
    (f"{COLLECT} --trials 99", "--trials 1"),
    (f"{COLLECT} --late-starts 2", "0 ... 1"),
    (f"{COLLECT} --workers 0", "--workers 2"),
    (f"{COLLECT} --worker-timeout 0", "a timeout above 0"),
    (f"{COLLECT} --pose fixed", "--poses"),
    (f"{COLLECT} --num-points 0", "0"),
    (f"{COLLECT} --image-size 1", "16 ... 2048"),
    (f"{COLLECT} --part 3/2", "3/2"),
    ("replay", "DIR"),
    ("replay some/absent", "some/absent"),
    ("replay some/absent --episod 1", "--episode"),
    ("replay dataset --out replay.txt", "allowed: .mp4"),
    ("render some/absent", "some/absent"),
    ("render", "adamanip render --help"),
    ("memory some/absent --out new", "some/absent"),
    ("memory dataset", "--out"),
    ("memory dataset --out new --memory evnts", "did you mean events?"),
    ("check some/absent", "some/absent"),
    ("check --replai 1 x", "--replay"),
    ("check dataset --assets nowhere", "does not exist"),
    ("keyframes some/absent --out new", "some/absent"),
    ("keyframes --out", "--out"),
    ("stats some/absent", "some/absent\n"),
    ("merge some/absent other --out new", "some/absent"),
    ("merge one --ut new", "--out"),
    ("filter some/absent --out new --where success=true", "some/absent"),
    ("filter --were success=true x", "--where"),
    ("split some/absent --out new", "--parts"),
    ("split some/absent", "--out"),
    ("split dataset --out new --parts 0.5 0.5", "Unrecognized options: 0.5\n  allowed:"),
    ("split dataset --out new --seed 1.5", "allowed: --seed INT"),
    ("view some/absent --out x.png", "some/absent"),
    ("view dataset", "--out"),
    ("merge dataset dataset --out new", "dataset"),
    ("filter dataset --out /proc/x --where success=true", "/proc/x"),
    (f"{COLLECT} --repo-id a/b/c", "a/b/c"),
    ("push datset x --repo-id a/b", "dataset"),
    ("push dataset some/absent --repo-id a/b --dry-run", "some/absent"),
    ("push dataset --repo-id a/b", "dataset DIR"),
    ("push dataset dataset --repo-id a/b --category door", "--category with environment"),
    ("push dataset dataset --repo-id a/b --dataset x/y", "--dataset with model"),
    ("push dataset dataset --repo-id a/b --results x.json", "--results with model"),
    ("push model dataset --repo-id a/b --category door", "--category with environment"),
    ("push model dataset --repo-id a/b --assets x", "--assets with dataset"),
    ("push environment --repo-id a/b --dataset x/y", "--dataset with model"),
    ("push environment --repo-id a/b --assets x", "--assets with dataset"),
    ("push environment dataset --repo-id a/b", "environment takes none"),
    ("push environment --repo-id safes", "safes"),
    ("push environment --repo-id a/b --release 1.0", "1.0"),
    ("push environment --repo-id a/b --category fridge", "fridge"),
    ("push environment --repo-id a/b --results nothing.json", "nothing.json"),
    ("push model nowhere --repo-id a/b", "not a complete checkpoint"),
    ("push model nowhere --repo-id a/b --dataset local/safes", "local/safes"),
    ("objects --category dor", "did you mean door?"),
    ("objects --objects 4:4", "Wrong selection"),
    ("objects --category lamp --objects unsen", "Wrong selection"),
    ("objects --objects 0:99999999999", "numbers below 10^6"),
    ("objects --size 5", "cannot be drawn"),
    ("objects --assets nowhere", "does not exist"),
    ("annotate nowhere", "does not exist"),
    ("annotate dataset", "No safe found"),
    ("objects --out sheet.doc", ".png"),
    ("objects --columns 0", "--columns 9"),
    ("annotate --categry x", "--category"),
    ("calibrate some/absent", "some/absent"),
    ("report", "log"),
    ("report absent.jsonl", "absent.jsonl"),
    ("report log.jsonl --out a.png --out b.png", "given twice"),
    ("collect demos --control dense --cameras front --cameras wrist", "--cameras FIRST SECOND"),
    ("report dataset", "adamanip stats dataset"),
    ("report log.jsonl --out x.gif", ".png"),
    ("benchmark", "--scale cpu"),
    ("benchmark --methods dp3_adaptiv", "did you mean dp3_adaptive?"),
    ("benchmark --scale smoke --categories door", "--list"),
    ("benchmark --scale smok", "did you mean smoke?"),
    ("expert --expert-strateg paper", "--expert-strategy"),
    ("expert --split tests", "did you mean test?"),
    ("expert --episodes 0", "--episodes 50"),
    ("expert --seed -5", "--seed 1000"),
    ("expert --episode-log dataset", "dataset"),
    ("expert --max-failed-tries bst", "best"),
)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "dataset" / "meta").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    for display in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(display, raising=False)
    return tmp_path


def test_every_command_is_among_them() -> None:
    assert set(COMMANDS) <= {line.partition(" ")[0] for line, _ in WRONG}
    assert len(WRONG) >= 60


@pytest.mark.parametrize(("line", "word"), WRONG)
def test_a_wrong_input_is_one_error(line: str, word: str, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = sorted(place.rglob("*"))
    assert main(line.split()) == 2
    said = capsys.readouterr()
    assert said.err.startswith("error: ")  # not a box of the parser
    assert word in said.err
    assert not {"Traceback", "╭"} & set(said.err.replace("╭", " ╭ ").split())
    assert max(map(len, said.err.splitlines())) < 400
    assert sorted(place.rglob("*")) == before
