"""What drivecal's parts say to each other: pydantic models over HTTP, plain frozen data over Ray."""
