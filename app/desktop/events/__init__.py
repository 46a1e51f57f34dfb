"""Events: their log, safety orders, and questions to the operator."""
