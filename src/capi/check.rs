//! What crosses the border: arguments on their way in, errors and panics on their way out.

use crate::{Error, Result};
use std::any::Any;
use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// How a call ended: the exit codes of the command.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum FnoptStatus {
    /// Done.
    Done = 0,
    /// Bad input or environment: an argument, a file, a device.
    BadInput = 2,
    /// The simulation became non-finite; its state can still be read and replaced.
    NonFinite = 3,
}

thread_local! {
    static LAST: RefCell<CString> = RefCell::default();
}

pub(super) fn last_error() -> *const c_char {
    LAST.with_borrow(|text| text.as_ptr())
}

/// Keeps a text for [`last_error`].
fn keep(text: &str) {
    let text = CString::new(text.replace('\0', "?")).unwrap_or_default();
    LAST.with_borrow_mut(|last| *last = text);
}

fn text_of(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or(panic.downcast_ref::<&str>().copied()).unwrap_or("unknown")
}

/// Runs the body of a function and returns its status. A panic, which is a bug of the library, does not cross the border.
pub(super) fn status(body: impl FnOnce() -> Result<()>) -> FnoptStatus {
    match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(())) => FnoptStatus::Done,
        Ok(Err(error)) => {
            keep(&error.to_string());
            if matches!(error, Error::NonFinite { .. }) {
                FnoptStatus::NonFinite
            } else {
                FnoptStatus::BadInput
            }
        }
        Err(panic) => {
            keep(&format!("fnopt: internal error: {}", text_of(&*panic)));
            FnoptStatus::BadInput
        }
    }
}

/// Runs the body of a function that returns a value, or `other` after a panic.
pub(super) fn value<T>(other: T, body: impl FnOnce() -> T) -> T {
    catch_unwind(AssertUnwindSafe(body)).unwrap_or_else(|panic| {
        keep(&format!("fnopt: internal error: {}", text_of(&*panic)));
        other
    })
}

/// Returns the error of an argument that is missing.
pub(super) fn missing(name: &str) -> Error {
    Error::invalid("argument", name, "a pointer", "NULL")
}

/// Hands what `make` makes to the caller, who frees it as a box.
///
/// # Safety
///
/// `to` must be NULL or point to room for a pointer.
pub(super) unsafe fn give<T>(make: impl FnOnce() -> Result<T>, to: *mut *mut T, name: &str) -> Result<()> {
    if to.is_null() {
        return Err(missing(name));
    }
    let made = Box::into_raw(Box::new(make()?));
    // SAFETY: the caller's.
    unsafe { to.write(made) };
    Ok(())
}

/// Returns the text of an argument, `None` for NULL.
///
/// # Safety
///
/// It must be NULL or point to a text that ends with a zero, and stay as it is for as long as the text is used.
pub(super) unsafe fn text<'a>(argument: *const c_char, name: &str) -> Result<Option<&'a str>> {
    if argument.is_null() {
        return Ok(None);
    }
    // SAFETY: the caller's.
    let text = unsafe { CStr::from_ptr(argument) };
    text.to_str().map(Some).map_err(|_| Error::invalid("argument", name, "UTF-8", text.to_string_lossy()))
}

/// Returns the elements of an argument, `None` for NULL.
///
/// # Safety
///
/// It must be NULL or point to `count` elements that stay as they are for as long as the slice is used.
pub(super) unsafe fn slice<'a, T>(argument: *const T, count: usize) -> Option<&'a [T]> {
    // SAFETY: the caller's.
    (!argument.is_null()).then(|| unsafe { std::slice::from_raw_parts(argument, count) })
}

/// Returns the room that an argument points to, which must be that of `expected` elements.
///
/// # Safety
///
/// It must be NULL or point to room for `count` elements that nothing else uses meanwhile.
pub(super) unsafe fn room<'a, T>(
    argument: *mut T,
    count: usize,
    expected: usize,
    name: &str,
) -> Result<&'a mut [T]> {
    if argument.is_null() {
        return Err(missing(name));
    }
    if count != expected {
        return Err(Error::invalid("argument", name, format!("room for {expected} numbers"), count));
    }
    // SAFETY: the caller's.
    Ok(unsafe { std::slice::from_raw_parts_mut(argument, count) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panics_and_errors_become_texts() {
        let text = || {
            // SAFETY: it is a text of this thread.
            unsafe { CStr::from_ptr(last_error()) }.to_str().unwrap().to_owned()
        };
        assert_eq!(status(|| Err(Error::NonFinite { frame: 3, cloth: 1 })), FnoptStatus::NonFinite);
        assert_eq!(text(), "frame 3: cloth 1 became non-finite");
        assert_eq!(status(|| panic!("by {}", 7)), FnoptStatus::BadInput);
        assert_eq!(text(), "fnopt: internal error: by 7");
        assert_eq!(status(|| Ok(())), FnoptStatus::Done);
        assert_eq!(value(5, || panic!("again")), 5);
        assert_eq!(text(), "fnopt: internal error: again");
    }
}
