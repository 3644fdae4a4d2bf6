"""GIFs of one palette: colours that look as they were drawn, parts that stay written once."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from pgm.plot.moving.movies import GifWriter, Palette, movie_writer, write_movie


def pixels(colours):
    """RGBA pixels as numbers of four bytes, a row of forty a colour."""
    rgba = np.concatenate([colours, np.full((len(colours), 1), 255)], axis=1)
    column = np.ascontiguousarray(rgba, dtype=np.uint8).view("<u4")
    return np.repeat(column, 40, axis=1)


def shown(palette, colours):
    index = palette.indices(pixels(colours))[:, 0]  # which may add to the palette
    return np.array(palette.flat).reshape(-1, 3)[index]


def test_few_colours_are_kept_as_they_are():
    first = np.array([[255, 255, 255], [0, 114, 178], [0, 0, 0]])
    palette = Palette(Image.fromarray(first[None].astype(np.uint8)))
    later = np.array([[213, 94, 0], [255, 255, 255], [0, 158, 115], [0, 114, 178]])
    assert shown(palette, first).tolist() == first.tolist()
    assert shown(palette, later).tolist() == later.tolist()
    assert shown(palette, first).tolist() == first.tolist()


@pytest.mark.slow
def test_more_colours_than_there_are_places_take_the_nearest():
    rng = np.random.default_rng(0)
    first, later = (rng.integers(0, 256, (3000, 3)) for _ in range(2))
    palette = Palette(Image.fromarray(first[None].astype(np.uint8)))
    found = shown(palette, later)
    assert len(palette.flat) == 3 * 256
    flat = np.array(palette.flat).reshape(-1, 3)
    apart = np.abs(later[:, None] - flat).max(axis=-1)
    assert (np.abs(found - later).max(axis=-1) == apart.min(axis=1)).all()


def test_colours_that_hardly_differ_or_are_rare_take_no_place():
    palette = Palette(Image.fromarray(np.full((4, 4, 3), 200, dtype=np.uint8)))
    before = len(palette.flat)
    shown(palette, np.array([[201, 199, 203]]))
    palette.indices(pixels(np.array([[0, 0, 0]]))[:, :10])
    assert len(palette.flat) == before


def test_a_film_has_its_colours_rate_and_pictures(tmp_path):
    figure = Figure(figsize=(2, 1), dpi=50)
    ax = figure.add_axes((0, 0, 1, 1))
    ax.axis("off")
    colours = ["#0072b2", "#d55e00", "#009e73"]
    path = write_movie(
        movie_writer(tmp_path / "a.gif", 5.0),
        tmp_path / "a.gif",
        figure,
        lambda k: figure.set_facecolor(colours[k]),
        3,
        50,
    )
    with Image.open(path) as film:
        assert (film.n_frames, film.size) == (3, (100, 50))
        for k, colour in enumerate(colours):
            film.seek(k)
            assert film.info["duration"] == 200
            rgb = np.asarray(film.convert("RGB"))
            due = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
            assert (rgb == due).all()
        assert film.info["loop"] == 0


def test_nothing_is_written_of_no_pictures(tmp_path):
    writer = GifWriter(fps=1)
    with writer.saving(Figure(), str(tmp_path / "a.gif"), 50):
        pass
    assert not list(tmp_path.iterdir())


def test_a_film_that_hardly_changes_is_small(tmp_path):
    """A part that stays is written once: ten pictures take less than twice the room of one."""
    rng = np.random.default_rng(0)
    sizes = []
    for count in (1, 10):
        figure = Figure(figsize=(3, 3), dpi=60)
        ax = figure.add_axes((0, 0, 1, 1))
        ax.imshow(rng.random((40, 40)), aspect="auto")
        (dot,) = ax.plot([], [], "o", color="#d55e00")
        path = tmp_path / f"{count}.gif"
        write_movie(
            movie_writer(path, 5.0),
            path,
            figure,
            lambda k, dot=dot: dot.set_data([k], [20]),
            count,
            60,
        )
        sizes.append(path.stat().st_size)
    assert sizes[1] < 2.0 * sizes[0]


@pytest.mark.parametrize("rate", [0, -1.0, np.inf, "fast", None])
def test_a_rate_is_a_number_above_nothing(rate):
    with pytest.raises(ValueError, match="rate is a number of pictures a second, above 0, not"):
        movie_writer("a.gif", rate)
