"""The gate's process, as the driver starts it: the file descriptors of its four sockets, then the driver's process id."""

import importlib
import os
import socket
import sys

from stressbot_driver.backends.base import Backend, Listener, construct
from stressbot_driver.clock import WallClock
from stressbot_driver.gate.claim import claim
from stressbot_driver.gate.gate import Gate, Opening, Sockets
from stressbot_driver.gate.hardening import harden
from stressbot_driver.gate.memory import read_object


def main(descriptors: list[int]) -> None:
    """Serve the driver at the other ends until it is gone; the process then ends."""
    refused = harden()

    def read_opening(configuration: int) -> Opening:
        asked = read_object(configuration)
        module, _, name = asked["class"].partition(":")
        notes = [refused] if refused else []

        def make(listener: Listener) -> Backend:
            backend_class = getattr(importlib.import_module(module), name)
            if backend_class.RESOURCE and (resource := asked["options"].get(backend_class.RESOURCE)):
                _, done = claim(str(resource))
                notes.extend([done] if done else [])
            return construct(asked["backend"], backend_class, asked["bench"], WallClock(), listener, asked["options"])

        return Opening(make, asked["timeout"], len(asked["bench"].ids), notes)

    Gate(Sockets(*(socket.socket(fileno=descriptor) for descriptor in descriptors)), read_opening).run()
    os._exit(0)  # whatever a thread is still waiting for


main([int(argument) for argument in sys.argv[1:5]])
