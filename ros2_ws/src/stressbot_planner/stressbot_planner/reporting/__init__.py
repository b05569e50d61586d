"""Pictures and figures of plans."""
