"""From linear colour to display code values."""
