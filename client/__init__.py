"""The command line and the Python client, over HTTP alone.

`client.local` renders in process and is the one module here that imports the tracer; `client.serve` starts the farm.
"""
