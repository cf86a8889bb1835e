"""Film: sums of samples on their way to a picture.

`tile` holds the format in which a worker hands its sums over, `develop` turns sums into pixels, `writer` streams
pixels into EXR and PNG, `preview` draws what is done so far. Importing this package loads numpy at most;
OpenImageIO comes in with the first writer.
"""
