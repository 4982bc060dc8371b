"""How the processes of the coordinator are set up from outside."""
