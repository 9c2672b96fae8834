"""Pictures of evaluations: the counts of a bar stand where its interval's line does not cross them."""

from __future__ import annotations

import pytest

from lerobot_adamanip.evaluation.plots import _LABEL_PERCENT, _label_bar, new_figure
from lerobot_adamanip.evaluation.rates import rate


@pytest.mark.parametrize("episodes", [1, 2, 5, 10, 100])
def test_no_line_crosses_a_label(episodes: int) -> None:
    for count in range(episodes + 1):
        axes, success = new_figure(8.0, 4.6).subplots(), rate(count, episodes)
        _label_bar(axes, 0.0, success, 0.8)
        (label,) = axes.texts
        beside = label.get_position()[0] > 0.1
        bottom = label.get_position()[1]
        assert beside or bottom + _LABEL_PERCENT < 100 * success.low + 1.6 or bottom > 100 * success.high
        assert bottom + _LABEL_PERCENT <= 103
