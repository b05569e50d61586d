"""Every scenario of the repository, planned and driven through real nodes: the robots end where the plan says."""

import pytest
from system_rig import SCENARIOS, largest_error

from stressbot_planner.errors import ErrorCode
from stressbot_planner.ros import conversion

PLANNERS = ("optimize", "pure_control")
TIME_LIMIT = 30.0
AGREEMENT = 1e-6
"""units and rad"""


@pytest.mark.parametrize("path", sorted([*SCENARIOS.glob("*.yaml"), SCENARIOS / "rivals/gcsr.yaml"]), ids=lambda path: path.stem)
def test_robots_end_where_the_plan_says(new_system, path):
    system = new_system(scenario=path, real_time_factor=0.0)
    executed = []
    for planner in PLANNERS:
        answer = system.plan(planner=planner, time_limit=TIME_LIMIT, timeout=2 * TIME_LIMIT)
        if not answer.success:
            assert answer.error_code in (ErrorCode.UNSUPPORTED, ErrorCode.NO_PLAN_FOUND), answer.error_msg
            continue
        poses, scene = system.execute(answer.plan)
        start, predicted = conversion.poses_from_plan(answer.plan, scene)
        assert largest_error(start, scene.starts) < 1e-9
        assert largest_error(poses, predicted) < AGREEMENT
        assert system.client.driver_status.sequence_time == pytest.approx(
            answer.plan.execution_time + answer.plan.selection_time, rel=1e-9
        )
        executed.append(planner)
        system.reset()
    assert executed, "no planner found a plan"
    system.processes.close()
    assert system.processes.exit_codes == {"driver": 0, "sequencer": 0, "planner": 0}
