"""What derivatives through impacts are worth: studies of the guide to derivatives."""
