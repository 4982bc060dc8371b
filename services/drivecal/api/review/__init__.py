"""The review sheet: its route, and its data from the functions behind the other answers."""
