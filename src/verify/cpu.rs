//! stub
pub struct CpuStages;
