"""The picture of the preview's page without a browser: zoom, dragging, and the rectangle of an edge."""

from types import SimpleNamespace

from gpusim.apps.preview.canvas import Canvas

SHAPE = 60, 90


def canvas():
    """A canvas whose elements only remember their content."""
    touched = []
    session = SimpleNamespace(crop=None, touch=lambda: touched.append(1))
    made = Canvas(session, "token", SHAPE)
    made._picture = SimpleNamespace(style=lambda text: None)
    made._overlay = SimpleNamespace(content="")
    return made, touched


def mouse(made, kind, row, col, buttons=1):
    made._on_mouse(SimpleNamespace(image_y=row, image_x=col, type=kind, buttons=buttons))


def test_a_zoomed_picture_is_dragged():
    made, touched = canvas()
    made._on_size(SimpleNamespace(args={"width": 180}))
    mouse(made, "mousemove", 30.0, 45.0, buttons=0)
    assert made.at == (30, 45)
    made.zoom(1)
    first = made.session.crop
    assert first.rows < SHAPE[0] and len(touched) == 1
    mouse(made, "mousedown", 30.0, 45.0)
    mouse(made, "mousemove", 20.0, 45.0)
    second = made.session.crop
    assert second == first.move(round(10 * first.rows / SHAPE[0]), 0, SHAPE) != first
    mouse(made, "mouseup", 20.0, 45.0)
    made.zoom(-1)
    assert made.session.crop is None


def test_an_edge_is_selected_in_pixels_of_the_frame():
    made, _ = canvas()
    made.measures = True
    mouse(made, "mousedown", 10.0, 50.0)
    mouse(made, "mousemove", 30.0, 20.0)
    assert made.edge == (slice(10, 31), slice(20, 51))
    # in percent of a picture of 60 rows and 90 columns
    assert 'x="22.222%" y="16.667%" width="34.444%" height="35.000%"' in made._overlay.content


def test_the_rectangle_stands_on_each_picture_side_by_side():
    made, _ = canvas()
    made.measures, made._box = True, SimpleNamespace(style=lambda text: None)
    mouse(made, "mousedown", 15.0, 0.0)
    mouse(made, "mouseup", 29.0, 44.0)
    made.follow(SHAPE, 2)
    rectangles = made._overlay.content.split("<rect ")[1:]
    size = 'y="25.000%" width="25.000%" height="25.000%"'
    assert [one.split(" fill")[0] for one in rectangles] == [
        f'x="0.000%" {size}',
        f'x="50.000%" {size}',
    ]


def test_a_click_picks_a_pixel_if_it_is_asked_to():
    made, _ = canvas()
    picked = []
    made.on_pick = lambda *at: picked.append(at)
    mouse(made, "mousedown", 30.2, 44.9)
    mouse(made, "mouseup", 30.4, 44.6)
    assert picked == [(30, 44)] and made.session.crop is None
