"""Plans at work: planning in a process of its own, driving in closed loop, mending what is left of a plan."""
