"""The farm: job states, store, queue, leases, tasks, assembler and supervisor.

The store is the truth; Redis is an index that can be rebuilt from it at any moment.
"""
