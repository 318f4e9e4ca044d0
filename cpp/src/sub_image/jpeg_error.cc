#include "sub_image/jpeg_error.h"

namespace sirpy {
namespace {

[[noreturn]] void ErrorExit(j_common_ptr info) {
  auto* errors = reinterpret_cast<JpegErrors*>(info->err);
  info->err->format_message(info, errors->message);
  std::longjmp(errors->jump, 1);
}

// Padding before a marker or after the last row, unknown revisions and colour transforms and odd
// colour profiles leave the pixels whole; every other warning means that some are made up.
bool MeansDamage(int code) {
  switch (code) {
    case JWRN_EXTRANEOUS_DATA:
    case JWRN_TOO_MUCH_DATA:
    case JWRN_JFIF_MAJOR:
    case JWRN_ADOBE_XFORM:
    case JWRN_BOGUS_ICC:
      return false;
    default:
      return true;
  }
}

void EmitMessage(j_common_ptr info, int level) {
  if (level < 0 && MeansDamage(info->err->msg_code)) ErrorExit(info);
}

}  // namespace

jpeg_error_mgr* JpegErrors::Install() {
  jpeg_std_error(&manager);
  manager.error_exit = ErrorExit;
  manager.emit_message = EmitMessage;
  return &manager;
}

}  // namespace sirpy
