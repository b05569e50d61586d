"""Files are written whole or not at all, and never over what a command reads."""

import os
import stat
from pathlib import Path

import pytest

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.system import files


def refused(call, *arguments) -> str:
    with pytest.raises(StressbotError) as caught:
        call(*arguments)
    assert (caught.value.code, caught.value.field) == (ErrorCode.UNREADABLE_FILE, "--output")
    return caught.value.message


@pytest.fixture
def scenario(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text("precious")
    (tmp_path / "folder").mkdir()
    (tmp_path / "soft").symlink_to(path)
    (tmp_path / "hard").hardlink_to(path)
    (tmp_path / "linked").symlink_to(tmp_path / "folder")
    return path


@pytest.mark.parametrize("name", ["scenario.yaml", "./scenario.yaml", "folder/../scenario.yaml", "soft", "hard", "linked/../soft"])
def test_what_is_read_is_not_written_over_under_any_name(scenario, name):
    said = refused(files.check_output, Path(f"{scenario.parent}/{name}"), scenario.parent / "missing", scenario)
    assert "is read by this command" in said


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("folder", "folder"),
        ("nowhere/x", "nowhere does not exist"),
        ("a" * 300, "too long"),
        ("x\0y", "null"),
        ("-", "dash"),
        ("scenario.yaml/x", "does not exist"),
    ],
)
def test_places_that_cannot_be_written_are_refused_before_any_work(scenario, monkeypatch, name, said):
    monkeypatch.chdir(scenario.parent)
    assert said in refused(files.check_output, Path(name))


def test_other_places_are_taken(scenario):
    for name in ("new.json", "./folder/new.json"):
        files.check_output(scenario.parent / name, scenario, None)


def test_old_content_stays_until_the_new_is_whole_and_nothing_is_left_behind(scenario):
    before = sorted(scenario.parent.iterdir())
    with pytest.raises(ZeroDivisionError), files.replacing(scenario) as stream:
        stream.write(b"half")
        stream.flush()
        assert scenario.read_text() == "precious"
        raise ZeroDivisionError
    assert scenario.read_text() == "precious"
    assert sorted(scenario.parent.iterdir()) == before
    files.write_text(scenario, "new ü")
    assert scenario.read_text(encoding="utf-8") == "new ü"
    assert sorted(scenario.parent.iterdir()) == before


def test_links_are_followed_and_permissions_kept(scenario):
    scenario.chmod(0o640)
    files.write_text(scenario.parent / "soft", "new")
    assert (scenario.parent / "soft").is_symlink()
    assert scenario.read_text() == "new"
    assert stat.S_IMODE(scenario.stat().st_mode) == 0o640


def test_a_new_file_has_the_usual_permissions(tmp_path):
    before = os.umask(0o027)
    try:
        files.write_text(tmp_path / "new", "x")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o640


@pytest.mark.parametrize("place", ["/dev/full", "/proc/self/mem", "/dev/null/x", "/proc/no"])
def test_what_cannot_be_written_is_one_refusal(place):
    assert place in refused(files.write_text, Path(place), "text")


def test_devices_stay_devices():
    files.write_text(Path("/dev/null"), "text")
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)


def test_folders_are_made_or_refused(scenario):
    files.make_folder(scenario.parent / "a" / "b")
    assert (scenario.parent / "a" / "b").is_dir()
    for name in ("scenario.yaml", "scenario.yaml/x", "a" * 300, "x\0y"):
        refused(files.make_folder, scenario.parent / name)
    refused(files.make_folder, Path("-"))
