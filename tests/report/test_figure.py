"""What the figure of a design shows, and what is refused before anything is drawn."""

import pytest

from eiwa.core.errors import EiwaError
from eiwa.core.outcome import measurements
from tests.study import small

pytest.importorskip("matplotlib")

from matplotlib.figure import Figure

from eiwa.report import figure


def test_the_bases_of_mirrored_arms_are_mirror_images():
    """Also where their midpoint does not lie on the mid-line."""
    values = {"layout.second": "mirrored", "layout.offset.0": 0.05, "layout.spacing": 0.3}
    ((_, measurement),) = measurements(small.spec(), values)
    panel = Figure().subplots()
    figure._panel(panel, measurement, *figure.VIEWS[0])
    bases = {line.get_color(): float(line.get_xdata()[0]) for line in panel.lines if line.get_marker() == "^"}
    assert bases == {figure.RIGHT: pytest.approx(0.2), figure.LEFT: pytest.approx(-0.2)}


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("workspace", "write png, pdf or svg at its end"),
        ("workspace.jpgg", "write png, pdf or svg at its end"),
        ("nowhere/workspace.png", "is no folder that can be written to"),
        ("folder.png", "is a folder"),
    ],
)
def test_a_figure_that_could_not_be_drawn(name, reason, tmp_path):
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(EiwaError, match=rf"{name}: cannot be drawn: .*{reason}"):
        figure.require(tmp_path / name)
