"""Studies that come with handbench: audit of a run, speed against error, stress."""
