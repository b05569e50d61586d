"""Domains that are handed out are nobody else's."""

import socket
from contextlib import ExitStack

import pytest
from stressbot_msgs.domains import reserve, reserved
from stressbot_msgs.errors import StressbotError


def test_each_gets_a_domain_of_its_own_until_it_is_given_back():
    with ExitStack() as stack:
        taken = []
        while len(taken) < 3:
            domain, hold = reserve()
            stack.enter_context(hold)
            taken.append(domain)
        assert len(set(taken)) == 3 and all(1 <= domain <= 101 for domain in taken)
    every = set()
    for _ in range(1000):
        domain, hold = reserve()
        hold.close()
        every.add(domain)
    assert len(every) > 50


def test_a_domain_with_a_participant_is_passed_over(monkeypatch):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as busy, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        busy.bind(("", 0))
        free.bind(("", 0))
        ports = {1: busy.getsockname()[1], 2: free.getsockname()[1]}
        free.close()
        monkeypatch.setattr("stressbot_msgs.domains._first_port", ports.get)
        for _ in range(20):
            domain, hold = reserve(2)
            hold.close()
            assert domain == 2
        with pytest.raises(StressbotError, match="domains 1 to 1 are taken"):
            reserve(1)


def test_an_environment_that_names_none_gets_one_that_is_kept_and_another_stays_as_it_is():
    empty, full = {}, {"ROS_DOMAIN_ID": "7"}
    with reserved(empty), reserved(full):
        taken = int(empty["ROS_DOMAIN_ID"])
        with pytest.raises(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as other:
            other.bind(f"\0stressbot_domain_{taken}")
    assert full == {"ROS_DOMAIN_ID": "7"}
