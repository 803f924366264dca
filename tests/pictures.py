"""What tests ask of pictures."""

from pathlib import Path

from matplotlib.colors import to_hex


def written(folder: Path, *results: object) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{number}.h5" for number in range(len(results))]
    for path, result in zip(paths, results):
        result.write(path)
    return paths


def visible(figure):
    return [axes for axes in figure.axes if axes.get_visible()]


def legend_texts(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def keys_of(figure):
    # the second name is that of matplotlib before 3.7
    names = ("legend_handles", "legendHandles")
    return [key for legend in figure.legends for key in next(getattr(legend, n) for n in names if hasattr(legend, n))]


def texts(figure):
    """Return the lines above the axes: the title and notes."""
    return [text.get_text() for text in figure.texts]


def looks(artists):
    """Return what lines look like: colour, line, marker, and whether it is filled."""
    return {
        (to_hex(line.get_color()), line.get_linestyle(), str(line.get_marker()), to_hex(line.get_markerfacecolor()))
        for line in artists
    }


def assert_inside(figure):
    """Check that every axes with its labels lies within the picture."""
    figure.canvas.draw()
    width, height = figure.canvas.get_width_height()
    for text in (*figure.texts, *(text for legend in figure.legends for text in legend.get_texts())):
        box = text.get_window_extent(figure.canvas.get_renderer())
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height, text.get_text()
    for axes in visible(figure):
        box = axes.get_tightbbox(figure.canvas.get_renderer())
        # Half a marker or tick label may stand over the axes' end, never over the edge of the picture.
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height
