"""The bench emulator node: an emulated waveform generator on a TCP port, amplifier and substrate behind it, poses out.

To a driver with the waveform_generator backend it is the instrument, to everybody else it is the tracker.
"""

import sys

from std_srvs.srv import Trigger
from stressbot_msgs.msg import SwarmPoses
from stressbot_msgs.process import ProcessNode, run

from stressbot_driver.bench import load_bench
from stressbot_driver.clock import WallClock
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.instruments.emulator import Emulator
from stressbot_driver.instruments.emulator_server import EmulatorServer
from stressbot_driver.ros.conversions import poses_message
from stressbot_driver.ros.parameters import Declaration, declare_all, number_of, value_of
from stressbot_driver.ros.qos import POSES
from stressbot_driver.simulation.substrate import Substrate

PARAMETERS = (
    Declaration("scenario", "", "Path of the scenario file that says what lies on the bench. Required.", read_only=True),
    Declaration("host", "127.0.0.1", "Address to listen on; 0.0.0.0 for every interface.", read_only=True),
    Declaration("port", 5025, "TCP port to listen on; 0: any free one, named in the log.", low=0, high=65535, read_only=True),
    Declaration("amplifier_gain", 20.0, "[V/V] of the amplifier before the substrate.", low=1e-6, high=1e6, read_only=True),
    Declaration("pose_rate", 50.0, "[Hz] Poses per second.", low=0.1, high=1000.0, read_only=True),
)


class InstrumentEmulatorNode(ProcessNode):
    """Publishes `swarm_poses`; the service `~/reset` puts the robots back at their starts.

    Raises StressbotError if the parameters or the scenario file are refused, or the port is taken.
    """

    def __init__(self) -> None:
        super().__init__("instrument_emulator")
        try:
            declare_all(self, PARAMETERS)
            path = value_of(self, "scenario")
            if not path:
                raise StressbotError(
                    ErrorCode.MISSING_FIELD, "scenario", "is not set: start with --ros-args -p scenario:=/path/to/scenario.yaml"
                )
            self._bench = load_bench(path)
            self._substrate = Substrate(self._bench)
            self._gain = number_of(self, "amplifier_gain")
            self._played = 0.0  # [s] since the robots were at their starts
            self._emulator = Emulator(WallClock(), self._play, repeated=self._repeat)
            host, port = value_of(self, "host"), value_of(self, "port")
            try:
                self._server = EmulatorServer(self._emulator, host, port)
            except OSError as error:
                message = f"cannot listen on {host}:{port} ({error}): choose another"
                raise StressbotError(ErrorCode.BACKEND_FAILURE, "port", message) from error
        except BaseException:
            self.destroy_node()
            raise
        self._publisher = self.create_publisher(SwarmPoses, "swarm_poses", POSES)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_timer(1.0 / number_of(self, "pose_rate"), self._publish)
        self.get_logger().info(f"an emulated 33522B listens on TCPIP0::{host}::{self._server.port}::SOCKET")

    def close(self) -> None:
        """Stop listening."""
        self._server.close()

    def _play(self, volts: float, seconds: float) -> None:
        level = volts * self._gain
        if level != self._substrate.level:
            self._substrate.apply(level)
        self._substrate.advance(seconds)
        self._played += seconds

    def _repeat(self, pattern: list[tuple[float, float]], count: int) -> None:
        self._substrate.repeat([(volts * self._gain, seconds) for volts, seconds in pattern], count)
        self._played += count * sum(seconds for _, seconds in pattern)

    def _publish(self) -> None:
        with self._server.lock:
            self._emulator.advance()
            poses, time = self._substrate.poses(), self._played
        message = poses_message(self._bench.swarm_id, time, poses)
        message.header.stamp = self.get_clock().now().to_msg()
        self._publisher.publish(message)

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._server.lock:
            if self._emulator.volts:
                response.success, response.message = False, "volts are on the substrate: stop the driver first"
                return response
            self._substrate.reset()
            self._played = 0.0
        response.success, response.message = True, "the robots are at their starts"
        return response


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_driver instrument_emulator`."""
    sys.exit(run("instrument_emulator", InstrumentEmulatorNode, args))
