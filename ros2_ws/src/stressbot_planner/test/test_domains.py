"""Domains that are handed out are nobody else's."""

import socket
from contextlib import ExitStack

import pytest

from stressbot_planner.errors import StressbotError
from stressbot_planner.system.domains import reserve


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
        monkeypatch.setattr("stressbot_planner.system.domains._first_port", ports.get)
        for _ in range(20):
            domain, hold = reserve(2)
            hold.close()
            assert domain == 2
        with pytest.raises(StressbotError, match="domains 1 to 1 are taken"):
            reserve(1)
