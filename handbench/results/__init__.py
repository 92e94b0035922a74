"""The reading side of a run: its records, scores as arrays and SQL, statistics, gate and laws."""
