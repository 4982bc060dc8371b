"""Messages between drivecal's parts: pydantic models over HTTP, plain frozen data over Ray."""
