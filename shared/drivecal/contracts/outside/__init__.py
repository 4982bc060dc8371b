"""Messages with others: sets of outside optimizers, results of vehicles and test benches."""
