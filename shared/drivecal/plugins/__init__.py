"""What can be plugged in (`ports`), how it is found (`registry`), and the setups made of it (`setups`)."""
