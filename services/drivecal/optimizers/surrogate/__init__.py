"""The optimizer `surrogate`: it learns a model for each scenario and asks cell by cell."""
