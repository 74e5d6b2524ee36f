"""Which nodes of a release discover which, examined from inside their pods.

`members` are the pods that take part. `looks` runs programs in them (`inside`) and reads the
answers; `findings` judges these, `losses` the messages that did not arrive. `check` does it after a
deploy and for `rigel status`.
"""
