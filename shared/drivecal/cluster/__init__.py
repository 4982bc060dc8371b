"""Code shared by the nodes of a Ray cluster and the dispatcher: Ray's settings, the start of a node, and the list of nodes."""
