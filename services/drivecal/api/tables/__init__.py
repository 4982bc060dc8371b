"""Tables as JSON pages, CSV and Parquet."""
