"""The path tracer that makes the truth; no method uses it."""
