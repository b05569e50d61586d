"""Over which transports the participants of a process talk."""

from collections.abc import MutableMapping
from importlib import resources

TRANSPORTS, PROFILES, RANGE = "FASTDDS_BUILTIN_TRANSPORTS", "FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE"
CHOICES = TRANSPORTS, PROFILES, "FASTDDS_DEFAULT_PROFILES_FILE"


def avoid_shared_memory(environment: MutableMapping[str, str]) -> None:
    """Let Fast DDS use UDP alone, unless the user has chosen transports or profiles.

    Its shared memory has locks: a process that is killed or frozen while it holds one makes others deaf. With discovery limited to
    this machine rmw_fastrtps insists on shared memory, so that a profile of ours says the rest of what that limit means; not where
    static peers are asked for besides, which only that limit can have. Two participants of one process are kept apart, too: where
    they call each other's functions, which is the default, they lock each other out now and then.
    """
    if any(environment.get(name) for name in CHOICES):
        return
    environment[TRANSPORTS], environment[PROFILES] = "UDPv4", profile("apart.xml")
    if environment.get(RANGE) == "LOCALHOST" and not environment.get("ROS_STATIC_PEERS"):
        environment[RANGE], environment[PROFILES] = "SYSTEM_DEFAULT", profile("localhost.xml")


def profile(name: str) -> str:
    """Return the path of one of our profiles of Fast DDS."""
    return str(resources.files("stressbot_msgs") / name)
