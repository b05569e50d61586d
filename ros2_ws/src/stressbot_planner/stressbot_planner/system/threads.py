"""How many threads linear algebra may use in this process and its children.

The optimiser's matrices are small: BLAS threads would wait for each other, on a busy machine for seconds a plan. The
libraries read these variables when numpy is first imported, so that `limit` must come before. Values that the user
has set are kept.
"""

import os
from collections.abc import MutableMapping

VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def limit(environment: MutableMapping[str, str] = os.environ) -> None:
    """Let linear algebra use one thread, unless the environment says otherwise."""
    for variable in VARIABLES:
        environment.setdefault(variable, "1")
