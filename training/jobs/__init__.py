"""Jobs on several processes or machines, and folders of a run that can be resumed."""
