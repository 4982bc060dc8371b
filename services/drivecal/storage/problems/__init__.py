"""Problems of users: pushed bundles."""
