import math

import numpy as np
import pytest

from stressbot_driver.codewords import allocate, check_codewords, default_codes
from stressbot_driver.errors import ErrorCode, StressbotError


def bits(codewords):
    return np.array([[int(bit) for bit in codeword] for codeword in codewords])


def equal(count):
    return np.ones(count)


@pytest.mark.parametrize("scheme", ["binary", "tight", "balanced", "by_radius"])
def test_named_schemes_tell_all_robots_apart(scheme):
    for count in range(1, 301):
        codewords = allocate(scheme, equal(count))
        assert check_codewords(codewords, equal(count), equal(count)) == codewords  # equal lengths, distinct, none empty


def test_by_radius_counts_up_within_each_set_of_equal_radius():
    assert allocate("by_radius", [1.0, 0.5, 2.0]) == ["1", "1", "1"]
    assert allocate("by_radius", [1.0, 0.5, 1.0, 0.5, 1.0, 2.0]) == ["01", "01", "10", "10", "11", "01"]
    for count in range(1, 301):
        radii = np.tile([1.0, 2.0], count)
        codewords = allocate("by_radius", radii)
        assert check_codewords(codewords, radii, equal(2 * count)) == codewords
        assert len(codewords[0]) == math.ceil(math.log2(count + 1))


def test_binary_is_the_papers_allocation():
    assert allocate("binary", equal(6)) == ["001", "010", "011", "100", "101", "110"]
    for count in range(1, 301):
        width = math.ceil(math.log2(count + 2))
        assert allocate("binary", equal(count)) == [format(k, f"0{width}b") for k in range(1, count + 1)]


def test_tight_uses_all_ones():
    assert allocate("tight", equal(7))[-1] == "111"
    for count in range(1, 301):
        assert len(allocate("tight", equal(count))[0]) == math.ceil(math.log2(count + 1))


def test_balanced_groups_differ_by_one_at_most_and_none_is_empty():
    assert allocate("balanced", equal(1)) == ["1"]
    assert allocate("balanced", equal(5)) == ["001", "110", "010", "101", "011"]
    for count in range(1, 301):
        codewords = allocate("balanced", equal(count))
        sizes = bits(codewords).sum(axis=0)
        assert sizes.max() - sizes.min() <= 1 and sizes.min() >= 1
        assert len(codewords[0]) == (1 if count == 1 else math.ceil(math.log2(count + 2)))
        for first, second in zip(codewords[::2], codewords[1::2], strict=False):
            assert (bits([first]) + bits([second]) == 1).all()


@pytest.mark.parametrize(
    ("codewords", "code"),
    [
        (["01"], ErrorCode.WRONG_COUNT),
        (["01", 10], ErrorCode.INVALID_CODEWORD),
        (["01", "0"], ErrorCode.INVALID_CODEWORD),
        (["01", "2a"], ErrorCode.INVALID_CODEWORD),
        (["", ""], ErrorCode.INVALID_CODEWORD),
        (["01", "00"], ErrorCode.EMPTY_CODEWORD),
        (["01", "01"], ErrorCode.DUPLICATE_CODEWORD),
    ],
)
def test_explicit_codewords_are_checked(codewords, code):
    with pytest.raises(StressbotError) as refused:
        check_codewords(codewords, equal(2), equal(2))
    assert refused.value.code == code


def test_a_codeword_may_be_shared_by_robots_of_different_radii():
    assert check_codewords(["1", "1"], np.array([1.0, 0.5]), equal(2)) == ["1", "1"]
    sentence = r"robots 2 and 3 share '1', and their turning radius ÷ speed is 0.1 \(0.3 ÷ 3\) and 0.1 \(0.7 ÷ 7\): equal"
    with pytest.raises(StressbotError, match=sentence) as refused:
        check_codewords(["1", "1", "1"], np.array([1.0, 0.3, 0.7]), np.array([1.0, 3.0, 7.0]))
    assert refused.value.code == ErrorCode.DUPLICATE_CODEWORD


def test_codes_are_digits_and_select_one_group_each():
    assert default_codes(4, 2) == [[0, 0], [0, 1], [1, 0], [1, 1]]
    assert default_codes(1, 2) == [[0]]
    assert default_codes(5, 4)[4] == [1, 0]
    for symbols in range(2, 8):
        for groups in range(1, 70):
            codes = default_codes(groups, symbols)
            length = len(codes[0])
            assert len({tuple(code) for code in codes}) == groups
            assert symbols**length >= groups and (length == 1 or symbols ** (length - 1) < groups)
            assert [int(np.ravel_multi_index(code, [symbols] * length)) for code in codes] == list(range(groups))
