"""Physical Finite-State Machines: one module per robot and group that it belongs to, all advanced at once."""

import numpy as np

INITIAL = 0


class PfsmBank:
    """The modules of n robots for groups G_1..G_{m-1}; robot j has module i if `membership[j, i]`.

    State 0..K counts the symbols of its code that a module has accepted; K is accepting, K+1 dead until a reset.
    G_m has a code of its own that no robot holds a module for, so that selecting it leaves every arm to the volts.
    """

    def __init__(self, membership: np.ndarray, codes: np.ndarray, symbol_count: int) -> None:
        """`membership` (n, m-1) bool, `codes` (m, K) symbols below `symbol_count`."""
        self._membership = membership
        groups = membership.shape[1]
        self._accepting = codes.shape[1]
        self._groups = np.arange(groups)
        self._next = _transitions(codes[:groups], symbol_count)
        self.state = np.zeros(membership.shape, dtype=np.intp)
        self.holding = np.zeros(len(membership), dtype=bool)

    def step(self, robots: np.ndarray | slice, symbol: np.ndarray) -> None:
        """The chosen robots take one symbol each: `symbol` is (number of chosen robots,) or (1,) for all alike."""
        self.state[robots] = self._next[self._groups, self.state[robots], symbol[:, None]]
        self._update()

    def reset(self, robots: np.ndarray | slice) -> None:
        """All modules of the chosen robots go to the initial state, and let go of the arm."""
        self.state[robots] = INITIAL
        self._update()

    def _update(self) -> None:
        """`holding` (n,): whether some module of a robot accepts and so holds its arm up."""
        self.holding = ((self.state == self._accepting) & self._membership).any(axis=1)


def _transitions(codes: np.ndarray, symbol_count: int) -> np.ndarray:
    """next[group, state, symbol] (m-1, K+2, L): on with the right symbol, dead with a wrong or a surplus one."""
    groups, length = codes.shape
    dead = length + 1
    table = np.full((groups, length + 2, symbol_count), dead, dtype=np.intp)
    for position in range(length):
        table[np.arange(groups), position, codes[:, position]] = position + 1
    return table
