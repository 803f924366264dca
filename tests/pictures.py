"""What tests ask of pictures."""

from __future__ import annotations


def visible(figure):
    """Return the axes that are shown."""
    return [axes for axes in figure.axes if axes.get_visible()]


def legend_texts(figure):
    """Return the texts of the figure's keys."""
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def assert_inside(figure):
    """Check that every axes with its labels lies within the picture."""
    figure.canvas.draw()
    width, height = figure.canvas.get_width_height()
    for axes in visible(figure):
        box = axes.get_tightbbox(figure.canvas.get_renderer())
        # Half a marker or tick label may stand over the axes' end, never over the edge of the picture.
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height
