"""Workers: jobs that go to an executor, and values on their way to other processes."""
