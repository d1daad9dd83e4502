"""One command writes every generated text, and says which it wrote."""

from generated_pages import WRITE, generated, stale, write


def test_every_generated_text_is_as_it_should_be():
    assert stale() == [], WRITE


def test_pages_manuals_tables_and_samples_are_generated():
    names = {path.name for path in generated()}
    assert {"commands.md", "rig.md", "camcal-rig.1", "formats.md", "messages.md", "benchmarks.md", "rig.yaml"} <= names


def test_a_text_is_written_into_a_new_folder_and_one_that_should_not_be_there_is_removed(tmp_path):
    path = tmp_path / "new" / "page.md"
    write(path, "text\n")
    assert path.read_text() == "text\n"
    write(path, None)
    assert not path.exists()
