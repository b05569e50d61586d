"""The reader of scenario files: numbers are decimal digits, words mean one thing, and no file is unfolded or nested without end."""

import math
import re
import time
import tracemalloc

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from stressbot_msgs import scenario_text
from stressbot_msgs.errors import ErrorCode, StressbotError

from stressbot_planner.formats import swarm_file

GOOD = """
name: {name}
swarm: {{speed: {speed}, turning_radius: 1, body_radius: 0.3, groups: {groups}}}
robots: [{{start: [2, 2, 0], goal: [2, 8]}}, {{start: [2, 12, 0], goal: [8, 12]}}]
"""


def text(name="one", speed="1", groups="binary") -> str:
    return GOOD.format(name=name, speed=speed, groups=groups)


def refusal(source: str) -> StressbotError:
    with pytest.raises(StressbotError) as caught:
        scenario_text.parse(source)
    assert str(caught.value).isprintable() and len(str(caught.value)) < 600
    return caught.value


# --- numbers and words --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("written", "value"),
    [("1", 1), ("+1", 1), ("1e3", 1000), ("1E+3", 1000), ("1.e-3", 0.001), ("+.5", 0.5), ("1.", 1), ("0.10", 0.1), ("0.5e0", 0.5)],
)
def test_decimal_digits_are_numbers(written, value):
    assert scenario_text.parse(text(speed=written))["swarm"]["speed"] == value


@given(st.floats(1e-9, 1e9) | st.integers(1, 10**9))
def test_every_number_that_python_writes_is_read_back(value):
    assert scenario_text.parse(text(speed=repr(value)))["swarm"]["speed"] == value


OTHERWISE = [
    "010", "-010", "00", "08", "007.5", "1:30", "1:30.5", "-190:20:30", "0b11", "1_0", "1_0.5", "0o17", "0x1F", "0X1f",
    "yes", "No", "on", "OFF", "2001-01-01", "2001-13-45", "2001-12-14t21:59:43.10-05:00", "=",
]  # fmt: skip


@pytest.mark.parametrize("written", OTHERWISE)
def test_what_readers_of_yaml_take_for_different_values_is_refused_as_it_was_written(written):
    for error in (refusal(text(speed=written)), refusal(text(name=written))):
        assert error.code == ErrorCode.WRONG_TYPE and error.field in ("swarm.speed", "name")
        assert f"is {written}, " in error.message
    scenario_text.parse(text(name=f'"{written}"'))


@given(st.text(st.sampled_from("0123456789abefox_:+-.eE~nNyYsS"), min_size=1, max_size=8))
def test_plain_scalars_are_their_decimal_value_or_their_text_or_refused(written):
    """What is read as text is text in YAML 1.1 too, and what is read as a number is that number in decimal digits."""
    try:
        name = scenario_text.parse(text(name=written))["name"]
    except StressbotError as error:
        assert error.code in (ErrorCode.WRONG_TYPE, ErrorCode.MALFORMED_FILE, ErrorCode.NOT_FINITE, ErrorCode.UNKNOWN_FIELD)
    else:
        assert name == written.strip() == yaml.safe_load(f"name: {written}")["name"]
    try:
        speed = scenario_text.parse(text(speed=written))["swarm"]["speed"]
    except StressbotError:
        return
    assert speed == float(written)
    assert not re.match(r"[-+]?0[0-9_xob]", written)


@pytest.mark.parametrize("written", [".inf", "-.INF", ".NaN", "1e999", "9" * 350, "9" * 5000])
def test_what_is_no_finite_double_is_refused(written):
    error = refusal(text(speed=written))
    assert (error.code, error.field) == (ErrorCode.NOT_FINITE, "swarm.speed")
    assert f"is {written[:30]}" in error.message


@pytest.mark.parametrize("words", [["0110", "1010"], ["1010", "0110"], ["10", "01"], ["1e1", "01"], ["0b1", "1"]])
def test_codewords_without_quotes_are_refused_as_they_were_written(words):
    error = refusal(text(groups=f"[{', '.join(words)}]"))
    assert (error.code, error.field) == (ErrorCode.INVALID_CODEWORD, "swarm.groups[0]")
    assert f"is {words[0]}: put codewords in quotes, as in " in error.message
    assert ('"0110"' if set(words[0]) - {"0", "1"} else f'"{words[0]}"') in error.message


@pytest.mark.parametrize("empty", ["", "~", "null"])
def test_nothing_is_no_value(empty):
    error = refusal(text(speed=empty))
    assert (error.code, error.field) == (ErrorCode.WRONG_TYPE, "swarm.speed")
    assert error.message == "is empty: give one number for all, or one per robot"


# --- YAML -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "said"),
    [
        (text() + "---\n" + text(), "second document"),
        (text(name="&a one") + "other: *a\n", "alias"),
        ("base: &b {x: 1}\n<<: *b\n" + text(), "alias"),
        (text(name="!!str one"), "tag"),
        (text(speed="!!float '1'"), "tag"),
        (text(name="! one"), "tag"),
        (text(name="!!binary aGk="), "tag"),
        (text(name="!!python/object/apply:os.system [ls]"), "tag"),
        (text() + "name: two\n", "'name' stands twice"),
        (text() + "? [1]\n: 2\n", "key"),
        (text(name="[" * 30), "deeper"),
        (text() + "\tname: x\n", "line"),
        (text(name="'open"), "line"),
        (text(name='"\\ud800"'), "line"),
        ("", "empty"),
        ("- a\n", "a list"),
        ('{"scenario": "x", "primitives": [], "activations": []}', "plan file"),
    ],
)
def test_what_a_scenario_never_needs_is_malformed(source, said):
    error = refusal(source)
    assert (error.code, error.field) == (ErrorCode.MALFORMED_FILE, "scenario")
    assert said in error.message


@pytest.mark.parametrize(("key", "field"), [*((key, key) for key in ("1", "true", "<<", "~", "''")), ('"\\e[2J"', "\\x1b[2J")])
def test_odd_keys_are_unknown(key, field):
    error = refusal(text() + f"{key}: {{name: x}}\n")
    assert (error.code, error.field) == (ErrorCode.UNKNOWN_FIELD, field)


@pytest.mark.parametrize("change", [lambda t: t.replace("\n", "\r\n"), lambda t: t.replace("\n", "\r"), lambda t: "\ufeff" + t])
def test_line_ends_and_byte_order_marks_make_no_difference(change, tmp_path):
    path = tmp_path / "s.yaml"
    path.write_bytes(change(text()).encode())
    assert scenario_text.read(path) == scenario_text.parse(text())


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-32", "latin-1"])
def test_other_encodings_are_refused(encoding, tmp_path):
    path = tmp_path / "s.yaml"
    path.write_bytes(text(name="ü").encode(encoding))
    with pytest.raises(StressbotError) as caught:
        scenario_text.read(path)
    assert caught.value.code in (ErrorCode.UNREADABLE_FILE, ErrorCode.MALFORMED_FILE)


def test_bombs_are_refused_cheaply():
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 12)]
    for bomb in ("\n".join(lines), "[" * 100_000, "{a: " * 50_000, "- " * 20_000):
        tracemalloc.start()
        begin = time.process_time()
        assert refusal(bomb).code == ErrorCode.MALFORMED_FILE
        assert time.process_time() - begin < 1.0
        assert tracemalloc.get_traced_memory()[1] < 5e6
        tracemalloc.stop()


# --- what is said ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "field", "hint"),
    [
        ("goal: [2, 8]", "gaol: [2, 8]", "robots[0].gaol", "did you mean goal?"),
        ("speed: 1,", "sped: 1,", "swarm.sped", "did you mean speed?"),
        ("name: one", "nmae: one", "nmae", "did you mean name?"),
        ("name: one", "colour: red", "colour", "use one of name, length_unit"),
    ],
)
def test_an_unknown_key_is_named_before_the_one_that_is_missing(old, new, field, hint):
    error = refusal(text().replace(old, new))
    assert (error.code, error.field) == (ErrorCode.UNKNOWN_FIELD, field)
    assert hint in error.message


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[2, 2, 0]", "[2, 2]", "has 2 entries: give [x, y, heading]"),
        ("[2, 8]", "[2, 8, 1, 0]", "has 4 entries: give 2 to 3"),
        ("[2, 8]", "nowhere", "give [x, y], where the heading is free, [x, y, heading], assign"),
        ("speed: 1,", "speed: 1e-12,", "is 1e-12: give a number from 1e-09 to 1e+09"),
        ("speed: 1,", "speed: fast,", "is fast: give one number for all, or one per robot"),
    ],
)
def test_refusals_say_what_to_write(old, new, said):
    assert said in refusal(text().replace(old, new)).message


CONTROL = ["\x00", "\x07", "\n", "\r", "\t", "\x1b[2J", "\x7f", "\x85", "\u2028", "\u202e", "\ufffe", "\ufeff"]


@pytest.mark.parametrize("character", CONTROL, ids=map(repr, CONTROL))
def test_names_with_control_characters_are_refused(character):
    quoted = '"a' + "".join(f"\\U{ord(c):08x}" for c in character) + '"'
    error = refusal(text(name=quoted))
    assert (error.code, error.field) == (ErrorCode.OUT_OF_RANGE, "name")
    assert f"U+{ord(character[0]):04X}" in error.message


@pytest.mark.parametrize("name", ["cost $^$", "ünïcode", "日本語", "a: b", "{x}", "<b>&amp;", "%s %d", "🤖", "a" * 200])
def test_other_names_are_taken_as_they_are(name):
    assert scenario_text.parse(text(name=yaml.safe_dump(name).removesuffix("...\n").strip()))["name"] == name


@pytest.mark.parametrize("name", [*OTHERWISE, "1e3", "1E-3", "-1.", "+.5", "12", "null", "~", "a: b", "$^$", "日本語"])
def test_names_that_look_like_something_else_come_back_from_a_file_of_calibrate(name, tmp_path):
    content = scenario_text.parse(text()) | {"name": name, "length_unit": 1e-05}
    content["swarm"]["groups"] = ["01", "10"]
    swarm_file.write(tmp_path / "s.yaml", content)
    assert scenario_text.read(tmp_path / "s.yaml") == content


@given(st.text(min_size=100, max_size=3000), st.sampled_from(["name", "speed", "groups", "key"]))
def test_whatever_is_quoted_is_quoted_short_and_printable(value, place):
    written = yaml.safe_dump(value, width=math.inf).removesuffix("...\n").strip()
    source = text() + f"{written}: 1\n" if place == "key" else text(**{place: written})
    if place != "name" or len(value) > 200:
        refusal(source)
