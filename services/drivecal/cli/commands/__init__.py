"""The commands of `drivecal`, one file each."""
