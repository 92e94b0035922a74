"""`handbench speed`: error against time of the lighting core, of its competitors and of every method."""
