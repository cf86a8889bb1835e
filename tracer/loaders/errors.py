"""What can go wrong with a file.

LoadError
"""


class LoadError(Exception):
    """A model or an image cannot be used.

    Parameters
    ----------
    file : str
        The file's name as its owner knows it, never a path of this machine.
    reason : str
        What is wrong, one sentence.
    mend : str
        What would make it right, never empty: it is the `expected` of the job's problem.
    pointer : str
        JSON pointer to the place in the scene that names the file, such as "/objects/3/asset"; may be empty.
    """

    def __init__(self, file: str, reason: str, mend: str, pointer: str = "") -> None:
        super().__init__(file, reason, mend, pointer)
        self.file = file
        self.reason = reason
        self.mend = mend
        self.pointer = pointer

    def __str__(self) -> str:
        return f"{self.file}: {self.reason}; {self.mend}"

    def at(self, pointer: str) -> "LoadError":
        """Return the same error with a place in the scene document."""
        return LoadError(self.file, self.reason, self.mend, pointer)
