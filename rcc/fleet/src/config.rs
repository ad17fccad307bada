//! The table `[fleet]` of a cell file. It opens nothing.
