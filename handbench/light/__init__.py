"""Environment maps and light-stage layouts."""
