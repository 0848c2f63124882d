"""The judgement: errors against the truth, named metrics of one run, consistency of many."""
