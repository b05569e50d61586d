"""Which codewords suit a task: the best bound over all of them, and a search with the planner's own cost."""
