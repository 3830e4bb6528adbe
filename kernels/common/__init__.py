"""What several stages share: counter-based random numbers, exactly rounded log and exp."""
