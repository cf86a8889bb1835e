"""`python -m client` is `smalti`."""

from client.cli import main

if __name__ == "__main__":
    main()
