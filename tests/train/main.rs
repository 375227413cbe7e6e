//! The host side of training: configuration, pools, the run and its folder.

mod arrays;
mod config;
mod learns;
mod pool;
mod ranks;
mod run;
mod support;
mod validation;
