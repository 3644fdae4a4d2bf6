"""Dynamic networks of tables, as chains of slices: messages are probabilities of states."""
