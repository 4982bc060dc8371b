"""The ego vehicle: a linear dynamic single-track model with the values of Table 8, and its tracking controller."""
