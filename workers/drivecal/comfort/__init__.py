"""How comfortable a drive was: metrics measured from its time series, and the reference scale that rates them."""
