"""Whole surveys of the twin through the whole chain, many times: what comes out, and why."""
