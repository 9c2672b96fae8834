"""The page about speed says what was measured, and nothing else."""

from __future__ import annotations

from bench_against import pair, summary
from check_common import ROOT
from speed_page import DEMO_STEPS, PAGE, POLICY, REPORT, page, read


def test_the_page_is_made_of_the_report() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(read(REPORT), read(POLICY))


def test_the_demo_trains_as_many_steps_as_the_page_says() -> None:
    assert f"steps=${{STEPS:-{DEMO_STEPS['fast']}}}" in (ROOT / "scripts" / "demo.sh").read_text(encoding="utf-8")


def test_a_ratio_says_how_many_times_better_whichever_way_better_is() -> None:
    assert pair([4.0, 8.0, 100.0], [2.0, 1.0, 3.0])["ratio"] == 4.0
    assert pair([4.0, 8.0, 100.0], [16.0, 24.0, 3.0], rate=True)["ratio"] == 2.0


def test_means_are_over_categories() -> None:
    rows = {
        "safe": {"tick_us": pair([100.0], [50.0]), "key_frames_per_core_second": pair([1.0], [4.0], rate=True)},
        "lamp": {"tick_us": pair([300.0], [50.0]), "key_frames_per_core_second": pair([3.0], [4.0], rate=True)},
    }
    means = summary({"simulator": rows})
    assert means["tick_us"] == {"before": 200.0, "after": 50.0, "ratio": 4.0}
    assert means["key_frames_per_core_second"] == {"before": 2.0, "after": 4.0, "ratio": 2.0}
