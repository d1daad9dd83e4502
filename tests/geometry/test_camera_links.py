"""The most certain path between two cameras."""

from camcal.geometry.frame_graph import CameraLink, certain_path


def link(first: str, last: str, std: float) -> CameraLink:
    return CameraLink((first, last), ("a",), 5, std)


def test_the_path_of_the_least_variance_is_taken():
    direct, one, two = link("a", "c", 5.0), link("a", "b", 3.0), link("c", "b", 3.0)
    # 3² + 3² < 5²: two links that are more certain together, though their deviations add up to more
    assert certain_path([direct, one, two], "a", "c") == (one, two)
    assert certain_path([direct, one, two], "c", "a") == (two, one)
    assert certain_path([link("a", "c", 4.0), one, two], "a", "c") == (link("a", "c", 4.0),)


def test_a_path_that_begins_with_the_surest_link_is_not_always_the_best():
    links = [link("a", "b", 0.1), link("b", "d", 9.0), link("a", "c", 2.0), link("c", "d", 2.0)]
    assert certain_path(links, "a", "d") == (links[2], links[3])


def test_cameras_that_nothing_links_have_no_path():
    assert certain_path([link("a", "b", 1.0)], "a", "c") == ()
    assert certain_path([], "a", "b") == ()
