"""What the nodes of a Ray cluster and the dispatcher have in common: how Ray is set, how a node is started, and who is there."""
