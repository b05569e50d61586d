"""What any thread asks of an executor is done in order, though the executor's own tasks are not."""

from functools import partial

import pytest
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from stressbot_planner.ros.in_order import InOrder


@pytest.fixture
def executor():
    context = Context()
    context.init()
    executor = SingleThreadedExecutor(context=context)
    yield executor
    executor.shutdown()
    context.try_shutdown()


def test_what_waits_together_is_done_in_the_order_in_which_it_came(executor):
    done, queue = [], InOrder()
    for number in range(20):
        queue.add(executor, partial(done.append, number))
    while len(done) < 20:
        executor.spin_once(timeout_sec=1.0)
    assert done == list(range(20))


def test_work_that_fails_keeps_nothing_back(executor):
    done, queue = [], InOrder()
    queue.add(executor, partial(done.index, "nothing"))
    queue.add(executor, partial(done.append, 1))
    with pytest.raises(ValueError):
        while not done:
            executor.spin_once(timeout_sec=1.0)
    while not done:
        executor.spin_once(timeout_sec=1.0)
    assert done == [1]
