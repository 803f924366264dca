"""A function that sees each state of a run."""

from collections.abc import Callable

import numpy as np

from pgmp_petsc.stepping.second_order_system import Observer, State


class Called(Observer):
    """It is called with number, time and state of each step."""

    def __init__(self, function: Callable[[int, float, State], object]) -> None:
        self._function = function

    def over(self, numbers: np.ndarray, times: np.ndarray, states: State) -> None:
        for k, (number, time) in enumerate(zip(numbers.tolist(), times.tolist())):
            self._function(number, time, states.at(k))
