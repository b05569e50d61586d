"""The process that holds the output: it alone has the backend, and it lives for as long as the driver says that all is well.

`client` is the driver's side, everything else is the gate's. What is promised is in docs/safety.md, and why in
docs/decisions/0017-gate.md.
"""
