"""The results of a campaign as a document, and a chosen set as a calibration file."""
