"""What a verb of the command line does; text goes to the rich console it is given."""
